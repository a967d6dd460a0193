"""The encoding of a text from outside: marked by its first bytes, else told by what its bytes look like."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from dataclasses import dataclass

SAMPLE = 1 << 16  # bytes that a guess looks at
_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF32_LE: "utf-32",
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
_USUAL = ("gb18030", "cp932", "cp949", "big5", "cp1250", "cp1252", "cp1251", "cp1253", "cp1254", "cp1257")
_WESTERN = frozenset("äöüÄÖÜßéèêàâçîôûñåøæÅØÆíóúáÀÉÈÊ°µ²³·±×Ω§´’“”–…€®™¿¡")
_RUNS = re.compile(rb"[\x80-\xff]+")


@dataclass(frozen=True)
class Encoding:
    """What a text's bytes are read by.

    Attributes:
        sure: whether they can hardly be anything else.
    """

    name: str
    sure: bool = True


def encoding_of(raw: bytes, *, whole: bool = True) -> Encoding:
    """The encoding of a text, or of its first bytes; latin-1, which takes any, where none of the usual ones fits."""
    if mark := next((name for mark, name in _MARKS.items() if raw.startswith(mark)), None):
        return Encoding(mark)
    if raw.count(0) > len(raw) // 4:
        return Encoding("utf-16-le" if raw[1::2].count(0) > raw[::2].count(0) else "utf-16-be")
    return Encoding("utf-8") if _fits(raw, "utf-8", whole) else _of_bytes(raw, whole)


def decoded(raw: bytes, encoding: str, *, whole: bool = True) -> str:
    """The text, without the last character where that is cut.

    Raises:
        LookupError: there is no such encoding of text.
        UnicodeError: the bytes are none of it.
    """
    if not codecs.lookup(encoding)._is_text_encoding:
        raise LookupError(encoding)
    return codecs.getincrementaldecoder(encoding)().decode(raw, final=whole)


def _of_bytes(raw: bytes, whole: bool) -> Encoding:
    """Western Europe's bytes, China's pairs, or the likeliest of the usual encodings by its texts."""
    sample = b"\n".join(_foreign(raw))[:SAMPLE]
    runs = _RUNS.findall(sample)
    leads = {lead for run in runs for lead in run[::2]}
    escaped = re.search(rb"[\x80-\xff]\\", sample)  # a backslash there is half of a Japanese or Chinese character
    pairs = not escaped and all(len(run) % 2 == 0 for run in runs)
    chinese = pairs and all(0xB0 <= lead <= 0xD7 for lead in leads)  # the usual characters of GB 2312
    western = not escaped and set(b"".join(runs).decode("cp1252", "replace")) <= _WESTERN
    units = pairs and all(0xA1 <= lead <= 0xA9 for lead in leads)  # signs, as China's for degrees Celsius
    if western and not units and _fits(raw, "cp1252", whole):
        return Encoding("cp1252", sure=not chinese)
    if units and _fits(sample, "gb2312") and _fits(raw, "gb18030", whole):
        return Encoding("gb18030", sure=not western)
    name = next((name for name in _ranked(sample) if _fits(raw, name, whole)), "latin-1")
    return Encoding(name, sure=chinese and name == "gb18030")


def _foreign(raw: bytes) -> Iterator[bytes]:
    """The strings with bytes beyond ASCII, or the lines that have such outside of strings."""
    for line in raw.splitlines():
        if not line.isascii():
            strings = [b'"%s"' % own for own in line.split(b'"')[1::2] if not own.isascii()]
            yield from strings or [line]


def _ranked(sample: bytes) -> list[str]:
    """The usual encodings, the likeliest first: little chaos, then Chinese of the common set, then their order."""
    from charset_normalizer import from_bytes  # noqa: PLC0415 (most files need no guess)

    chaos = {match.encoding: round(match.chaos, 2) for match in from_bytes(sample, cp_isolation=list(_USUAL))}
    last = None if _fits(sample, "gb2312") else "gb18030"
    return sorted(chaos, key=lambda name: (chaos[name], name == last, _USUAL.index(name)))


def _fits(raw: bytes, name: str, whole: bool = True) -> bool:
    try:
        decoded(raw, name, whole=whole)
    except UnicodeError:
        return False
    return True
