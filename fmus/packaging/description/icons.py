"""Icons of an FMU: small drawings as SVG, and as PNG for importers that show no SVG."""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np

SIZE = 64  # pixels of a PNG, either way
Point = tuple[float, float]


@dataclass(frozen=True)
class Stroke:
    """A line with round ends through points between (0, 0), top left, and (100, 100); one point is a disc."""

    points: tuple[Point, ...]
    width: float
    colour: tuple[int, int, int]


Drawing = tuple[Stroke, ...]

_FRAME = Stroke(((4, 4), (96, 4), (96, 96), (4, 96), (4, 4)), 4, (60, 70, 85))
_INK = (0, 90, 160)


@cache
def of_model(sampled: bool) -> Drawing:
    """A frame with a swing that dies away, or with the steps of its samples."""
    times = np.linspace(0, 1, 49)
    swing = 50 - 34 * np.exp(-2.2 * times) * np.cos(math.tau * 1.5 * times)
    points = [(14 + 72 * float(t), float(y)) for t, y in zip(times, swing, strict=True)]
    if sampled:
        held = points[::8]
        points = [at for (x, y), (until, _) in pairwise(held) for at in ((x, y), (until, y))]
    return _FRAME, Stroke(tuple(points), 5, _INK)


def disc(colour: tuple[int, int, int]) -> Drawing:
    """A filled disc."""
    return (Stroke(((50, 50),), 84, colour),)


def svg(drawing: Drawing) -> bytes:
    """The drawing as SVG."""
    paths = "".join(_path(stroke) for stroke in drawing)
    return f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 100 100">{paths}</svg>\n'.encode()


def _path(stroke: Stroke) -> str:
    points = stroke.points if len(stroke.points) > 1 else stroke.points * 2
    way = "L".join(f"{x:.1f} {y:.1f}" for x, y in points)
    red, green, blue = stroke.colour
    said = f'fill="none" stroke="#{red:02x}{green:02x}{blue:02x}" stroke-width="{stroke.width:g}"'
    return f'<path d="M{way}" {said} stroke-linecap="round" stroke-linejoin="round"/>'


@cache
def png(drawing: Drawing) -> bytes:
    """The drawing as PNG on a transparent ground, with soft edges."""
    pixels = np.zeros((SIZE, SIZE, 4))
    for stroke in drawing:
        covered = _covered(stroke)[..., None]
        ink = np.array([*stroke.colour, 255.0])
        pixels = ink * covered + pixels * (1 - covered)
    pixels[..., :3] /= np.maximum(pixels[..., 3:] / 255, 1e-9)  # a PNG has its colours as they are without the ground
    rows = np.rint(pixels).astype(np.uint8)
    raw = b"".join(b"\0" + row.tobytes() for row in rows)
    head = struct.pack(">IIBBBBB", SIZE, SIZE, 8, 6, 0, 0, 0)
    chunks = ((b"IHDR", head), (b"IDAT", zlib.compress(raw, 9)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(map(_chunk, *zip(*chunks, strict=True)))


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _covered(stroke: Stroke) -> np.ndarray:
    """Share of each pixel that lies under a stroke, (SIZE, SIZE)."""
    unit = 100 / SIZE
    centres = (np.arange(SIZE) + 0.5) * unit
    at = np.stack(np.meshgrid(centres, centres), axis=-1)
    points = np.array(stroke.points if len(stroke.points) > 1 else stroke.points * 2, dtype=float)
    nearest = np.full((SIZE, SIZE), np.inf)
    for start, end in pairwise(points):
        way = end - start
        share = np.clip(((at - start) @ way) / max(float(way @ way), 1e-12), 0, 1)
        nearest = np.minimum(nearest, np.linalg.norm(at - start - share[..., None] * way, axis=-1))
    return np.clip((stroke.width / 2 - nearest) / unit + 0.5, 0, 1)
