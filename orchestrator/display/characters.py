"""Two curves over time drawn in characters, for terminals and logs."""

from __future__ import annotations

import numpy as np

from orchestrator.display.thinning import Samples

OLD, NEW, BOTH = ".", "*", "#"
WIDTH, HEIGHT = 72, 12
_LABEL = 11  # characters of a number at the axis


Curve = tuple[Samples, Samples]
"""Time (K,) [s] and values (K,)."""


def plot(title: str, old: Curve, new: Curve, names: tuple[str, str] = ("old", "new")) -> str:
    """A drawing of two curves, all lines of it; `names` are theirs."""
    start, stop = min(old[0][0], new[0][0]), max(old[0][-1], new[0][-1])
    values = np.concatenate([old[1], new[1]])
    values = values[np.isfinite(values)]
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 0.0)
    if high == low:
        low, high = low - 1.0, high + 1.0
    marks = [_cells(*curve, (start, stop), (low, high)) for curve in (old, new)]
    signs = np.array([" ", OLD, NEW, BOTH])[marks[0] + 2 * marks[1]]
    labels = {0: f"{high:.4g}", HEIGHT - 1: f"{low:.4g}"}
    lines = [f"{labels.get(row, ''):>{_LABEL}} |{''.join(signs[row]).rstrip()}" for row in range(HEIGHT)]
    ends = f"{start:.4g}"
    axis = f"{'':>{_LABEL}} +{'-' * WIDTH}"
    below = f"{'':>{_LABEL}}  {ends}{f'{stop:.4g} s':>{WIDTH - len(ends)}}"
    return "\n".join([f"{title}   {OLD} {names[0]}  {NEW} {names[1]}  {BOTH} both", *lines, axis, below])


def _cells(time: Samples, values: Samples, times: tuple[float, float], heights: tuple[float, float]) -> Samples:
    """(HEIGHT, WIDTH) of 0 and 1: where the curve passes; of every column the whole height that it covers."""
    cells = np.zeros((HEIGHT, WIDTH), dtype=int)
    edges = np.linspace(*times, WIDTH + 1)
    finite = np.isfinite(values)
    if not finite.any():
        return cells
    time, values = time[finite], values[finite]
    stamps = np.union1d(time, edges[(edges >= time[0]) & (edges <= time[-1])])
    curve = np.interp(stamps, time, values)
    column = (np.searchsorted(edges, stamps, side="right") - 1).clip(0, WIDTH - 1)
    row = np.rint((heights[1] - curve) / (heights[1] - heights[0]) * (HEIGHT - 1)).astype(int)
    for number in np.unique(column):
        rows = row[column == number]
        cells[rows.min() : rows.max() + 1, number] = 1
    return cells
