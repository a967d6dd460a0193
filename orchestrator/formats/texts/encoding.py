"""The encoding of a text file, by its first bytes."""

from __future__ import annotations

import codecs
import re
from pathlib import Path
from typing import BinaryIO

from fmus.errors import TraceError

SAMPLE = 2**16  # bytes that are looked at
MARKS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF32_LE: "utf-32",
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
WESTERN = frozenset("äöüÄÖÜßéèêàâçîôûñåøæÅØÆíóúáµ°²³·±×Ωø§")


def first_lines(file: BinaryIO, encoding: str | None, path: Path) -> tuple[list[str], str]:
    """The first lines of a file, whole ones only, and its encoding: the one that is said, else what it looks like.

    Raises:
        TraceError: no such encoding, or the bytes are none of it; a line that is too long.
    """
    raw = file.read(SAMPLE + 1)
    file.seek(0)
    whole = len(raw) <= SAMPLE
    known = encoding or next((name for mark, name in MARKS.items() if raw.startswith(mark)), None) or _guess(raw, path)
    try:
        if not codecs.lookup(known)._is_text_encoding:
            raise LookupError
        text = codecs.getincrementaldecoder(known)().decode(raw[:SAMPLE], final=whole)
    except LookupError:
        raise TraceError(path, f"'{known}' is no encoding of text", "say `encoding: utf-8`, cp1252, gbk, ...") from None
    except UnicodeError:
        raise TraceError(path, f"is not {known.upper()} text", "say its `encoding`: cp1252, utf-16, gbk, ...") from None
    if "\0" in text:
        raise TraceError(path, "is no text", "check that it is a table of text, or say its `encoding`")
    lines = re.split(r"\r\n|\n|\r", text)
    if not whole and len(lines) == 1:
        raise TraceError(path, f"a header line is longer than {SAMPLE} bytes", "check that it is a table of text")
    return lines[:-1] if not whole or not lines[-1] else lines, known


def _guess(raw: bytes, path: Path) -> str:
    if raw.count(0) > len(raw) // 4:
        return "utf-16-le" if raw[1::2].count(0) > raw[::2].count(0) else "utf-16-be"
    try:
        codecs.getincrementaldecoder("utf-8")().decode(raw, final=len(raw) <= SAMPLE)
        return "utf-8"
    except UnicodeDecodeError:
        return _single_or_double(raw, path)


def _single_or_double(raw: bytes, path: Path) -> str:
    """Western Europe's bytes or China's pairs; numbers read alike in both, names do not."""
    runs = re.findall(rb"[\x80-\xff]+", raw)
    western = set(b"".join(runs).decode("cp1252", "replace")) <= WESTERN
    chinese = all(len(run) % 2 == 0 and all(0xB0 <= lead <= 0xD7 for lead in run[::2]) for run in runs)
    if western == chinese:
        raise TraceError(path, "is not UTF-8 text, nor surely cp1252 or gbk", "say its `encoding`")
    return "cp1252" if western else "gbk"
