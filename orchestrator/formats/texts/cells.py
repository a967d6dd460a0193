"""What a cell of a table of text holds, and which mark its decimal point is."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Literal

from fmus.errors import TraceError
from orchestrator.formats.layout import Decimal

Kind = Literal["number", "grouped", "flag", "stamp", "date", "text", "missing"]

MISSING = (
    *("-", "--", "---", "n.a.", "n/a", "na", "nan", "-nan", "null", "none", "#n/a", "#nv", "?", ""),
    *("#div/0!", "#value!", "#num!", "#ref!", "#name?", "#null!"),  # what Excel could not compute
    *("#wert!", "#zahl!", "#bezug!", "#valeur!", "#nombre!"),
)
BLANKS = " \u00a0\u2009\u202f"  # between thousands
MINUS = "\u2212"  # as it is typeset
STAMP = (
    r"^\s*(?:(?P<a>\d{1,4})(?P<mark>[-/.])(?P<b>\d{1,2}|[A-Za-z]{3})[-/.](?P<c>\d{1,4})(?:[ T_]|, )\s*"
    r"|(?P<days>\d{1,5}) days?,? +)?"
    r"(?P<hour>\d{1,2}):(?P<minute>\d{2})(?::(?P<second>\d{2})(?:[.,:](?P<fraction>\d{1,9})(?P<finer>\d*))?)?"
    r"\s*(?P<half>[AaPp]\.?[Mm]\.?)?\s*(?P<zone>Z|UTC|[+-]\d{2}:?\d{2})?\s*$"
)
BASIC, EXTENDED = r"^\s*(\d{4})(\d{2})(\d{2})[-T_ ](\d{2}):?(\d{2}):?(\d{2})", r"\1-\2-\3T\4:\5:\6"
"""A date without marks, 20260102T030405, and what `STAMP` knows it as."""
SHORT = r"^\s*\d{1,2}:\d{2}[.,]\d+\s*$"
"""Minutes and seconds, as Excel shows times."""
_STAMP = re.compile(f"{STAMP}|{SHORT}")
_DATE = re.compile(
    r"\d{4}(?P<mark>[-/.])\d{1,2}(?P=mark)\d{1,2}|\d{1,2}(?P<sign>[-/.])(\d{1,2}|[A-Za-z]{3})(?P=sign)(\d{4}|\d{2})"
)
_ANY_NUMBER = re.compile(rf"[+{MINUS}-]?(\d([\d.,'{BLANKS}]*\d)?[.,]?|[.,]\d+)([eE][+-]?\d+)?")
_UNSURE = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}")
_PLAIN: dict[Decimal, re.Pattern[str]] = {
    ".": re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?|[+-]?inf(inity)?", re.IGNORECASE),
    ",": re.compile(r"[+-]?(\d+(,\d*)?|,\d+)([eE][+-]?\d+)?|[+-]?inf(inity)?", re.IGNORECASE),
}
GROUPS: dict[Decimal, str] = {".": f",'{BLANKS}", ",": f".'{BLANKS}"}
"""Marks of decimals -> those that may be between thousands."""
_GROUPED = {
    mark: re.compile(rf"[+{MINUS}-]?\d{{1,3}}([{groups}]\d{{3}})+([{mark}]\d*)?|{MINUS}({_PLAIN[mark].pattern})")
    for mark, groups in GROUPS.items()
}


def is_value(cell: str) -> bool:
    """Whether a cell may be a sample, whatever its decimal point."""
    text = cell.strip()
    words = (*MISSING, "inf", "-inf")
    return bool(_ANY_NUMBER.fullmatch(text) or _is_stamp(text) or _DATE.fullmatch(text) or text.lower() in words)


def is_time_of_day(cell: str) -> bool:
    """Whether a cell holds a time without a date."""
    found = _STAMP.match(cell)
    return found is not None and not found["a"]


def kind(cell: str, decimal: Decimal) -> Kind:
    """What a cell holds when `decimal` is the mark of decimals."""
    text = cell.strip()
    if text.lower() in MISSING:
        return "missing"
    if _PLAIN[decimal].fullmatch(text):
        return "number"
    if _GROUPED[decimal].fullmatch(text):
        return "grouped"
    if text.lower() in ("true", "false"):
        return "flag"
    if _DATE.fullmatch(text):
        return "date"
    return "stamp" if _is_stamp(text) else "text"


def _is_stamp(text: str) -> bool:
    return _STAMP.match(re.sub(BASIC, EXTENDED, text)) is not None


def decimal_mark(cells: Iterable[str], separator: str, place: Path) -> Decimal:
    """The mark of decimals that the cells agree on.

    Raises:
        TraceError: they do not tell, such as 1,234 alone.
    """
    marked = [cell for cell in map(str.strip, cells) if set(cell) & set(".,") and not _DATE.fullmatch(cell)]
    numbers = [cell for cell in marked if _ANY_NUMBER.fullmatch(cell)]
    told = {mark for cell in numbers if (mark := _mark(cell))}
    unsure = next((cell for cell in numbers if "," in cell or separator == ";"), None)
    if len(told) > 1:
        raise TraceError(place, "has decimal points and decimal commas", "say `decimal: '.'` or `decimal: ','`")
    if not told and unsure is not None:
        grouped = unsure.replace(",", "").replace(".", "")
        raise TraceError(
            place,
            f"'{unsure}' may be {grouped} or {unsure.replace(',', '.')}",
            f"say `decimal: '{',' if ',' in unsure else '.'}'` if its mark is the decimal point, else the other",
        )
    return told.pop() if told else "."


def _mark(number: str) -> Decimal | None:
    """The mark of decimals in a number that has marks, None where it may be one of thousands."""
    marks: list[Decimal] = ["." if letter == "." else "," for letter in number if letter in ".,"]
    if len(set(marks)) == 2:
        return marks[-1]
    if len(marks) > 1:
        return "." if marks[0] == "," else ","
    return None if _UNSURE.fullmatch(number) else marks[0]
