"""The text of a database file out of its bytes: in the encoding that is said, told by the file, or guessed."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from pathlib import Path

from fmus.errors import DatabaseError

MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
GUESSES = ("gb18030", "cp932", "cp949", "big5", "cp1250", "cp1252", "cp1251", "cp1253", "cp1254", "cp1257")
WESTERN = frozenset("°µ²³±·×§´äöüÄÖÜßéèêàâçîôûñåøÅØíóúáΩÀÉÈÊ’“”–…€®™¿¡")
SAMPLE = 1 << 16  # bytes that a guess looks at
_DECLARED = re.compile(rb"<\?xml[^>]{0,200}\bencoding\s*=\s*[\"']([\w.-]{1,40})")
_RUNS = re.compile(rb"[\x80-\xff]+")


def text_of(path: Path, data: bytes, encoding: str | None) -> tuple[str, str]:
    """The text, and a line about the guess; "" where it took none.

    Raises:
        DatabaseError: there is no such encoding, or the bytes are none of it.
    """
    mark = next((name for mark, name in MARKS.items() if data.startswith(mark)), None)
    declared = _DECLARED.match(data.lstrip())
    known = encoding or mark or (declared[1].decode() if declared else None)
    if known is not None:
        return _decoded(path, data, known), ""
    try:
        return data.decode(), ""
    except UnicodeDecodeError:
        name = _guess(data)
    return data.decode(name), f"its text is read as {name}, which is a guess; --encoding or `encoding` says what it is"


def _decoded(path: Path, data: bytes, encoding: str) -> str:
    try:
        return data.decode(encoding)
    except UnicodeError as error:
        place = f"byte {error.start}" if isinstance(error, UnicodeDecodeError) else "it"
        raise DatabaseError(path, f"is no text: {place} is not {encoding}", "name its encoding") from None
    except LookupError:
        raise DatabaseError(path, f"there is no encoding '{encoding}'", "use for example utf-8 or cp1252") from None


def _guess(data: bytes) -> str:
    """The likeliest of the usual encodings by its texts; latin-1, which takes any byte, where none fits."""
    from charset_normalizer import from_bytes  # noqa: PLC0415 (most files need no guess)

    sample = b"\n".join(_foreign(data))[:SAMPLE]
    escaped = re.search(rb"[\x80-\xff]\\", sample)  # a backslash there is half of a Japanese or Chinese character
    runs = _RUNS.findall(sample)
    if not escaped and set(b"".join(runs).decode("cp1252", "replace")) <= WESTERN and _fits(data, "cp1252"):
        return "cp1252"
    units = all(0xA1 <= lead <= 0xA9 for run in runs for lead in run[::2])  # China's, as that for degrees Celsius
    if units and _fits(sample, "gb2312") and _fits(data, "gb18030"):
        return "gb18030"
    found = {match.encoding: match for match in from_bytes(sample, cp_isolation=list(GUESSES))}
    ranked = sorted(found, key=lambda name: _rank(name, found[name].chaos, sample))
    return next((name for name in ranked if _fits(data, name)), "latin-1")


def _foreign(data: bytes) -> Iterator[bytes]:
    """The strings with bytes beyond ASCII, or the lines that have such outside of strings."""
    for line in data.splitlines():
        if not line.isascii():
            strings = [b'"%s"' % own for own in line.split(b'"')[1::2] if not own.isascii()]
            yield from strings or [line]


def _rank(name: str, chaos: float, sample: bytes) -> tuple[float, int]:
    """Least for the likeliest: little chaos, then Chinese of the common set, then the order of `GUESSES`."""
    rare = name == "gb18030" and not _fits(sample, "gb2312")
    return round(chaos, 2), len(GUESSES) if rare else GUESSES.index(name)


def _fits(data: bytes, name: str) -> bool:
    try:
        data.decode(name)
    except UnicodeDecodeError:
        return False
    return True
