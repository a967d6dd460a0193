"""The text of a DBC, statement by statement, so that what a parser stumbles over can be taken out of it and told."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Callable, Iterator
from itertools import pairwise

from orchestrator.can.database.message import LeftOut

STRINGS = re.compile(r'"[^"\\]*(?:\\.[^"\\]*)*"|//[^\n]*')  # and comments
_COMMENT = re.compile(r"//[^\n]*")
_STATEMENT = re.compile(r"^[ \t]*([A-Z]+(?:_[A-Z]+)*_|VERSION)(?!\w)", re.MULTILINE)
_MESSAGE = re.compile(r"\s*BO_\s+(-?\d+)\s+(\w+)")
_SIGNAL = re.compile(r"\s*SG_\s+(\w+)(?:\s+(\w+))?\s*:")
_NUMBER = r"\s*[-+]?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?\s*"
_WHOLE_SIGNAL = re.compile(
    _SIGNAL.pattern
    + rf"{_NUMBER}\|{_NUMBER}@{_NUMBER}[-+]\s*\({_NUMBER},{_NUMBER}\)\s*\[{_NUMBER}\|{_NUMBER}\]"
    + r'\s*"[^"]*"\s*\w+(?:\s*,\s*\w+)*\s*'
)
_ABOUT = re.compile(r"\s*(?:SG_MUL_VAL_|SIG_VALTYPE_|VAL_)\s+(-?\d+)\s+(\w+)")
_ATTRIBUTE = re.compile(r'\s*BA_(?:DEF_)?\s*(?:BU_|BO_|SG_|EV_)?\s*"([^"]*)"')
_ENDED = ("CM_", "BA_", "BA_DEF_", "BA_DEF_DEF_", "VAL_", "VAL_TABLE_", "SIG_VALTYPE_", "SG_MUL_VAL_", "BO_TX_BU_")
_WHOLE_MESSAGE = re.compile(_MESSAGE.pattern + r"\s*:\s*\d+\s+\w+\s*")
_UNMARKED = ("VERSION", "NS_", "BS_", "BU_", "BO_", "SG_")  # statements that end without a semicolon
_UNSENT = "VECTOR__INDEPENDENT_SIG_MSG"  # holds signals of no message


class DbcText:
    """The text without what was taken out, line by line where it was.

    Attributes:
        left_out: messages and signals that were taken out.
        notes: of other statements, a line each.
    """

    def __init__(self, text: str) -> None:
        self.left_out: list[LeftOut] = []
        self.notes: list[str] = []
        found = list(_STATEMENT.finditer(STRINGS.sub(_blank, text)))
        self._begins = [match.start() for match in found]
        self._keywords = [match[1] for match in found]
        borders = [*self._begins, len(text)]
        self._head = text[: borders[0]]
        self._parts = [text[begin:end] for begin, end in pairwise(borders)]
        self._messages = {match[1]: number for number, match in self._matches(("BO_",), _MESSAGE)}
        self._about: dict[str, list[int]] = {}
        for number, match in self._matches(("SG_MUL_VAL_", "SIG_VALTYPE_", "VAL_"), _ABOUT):
            self._about.setdefault(match[1], []).append(number)

    @property
    def text(self) -> str:
        """What is left."""
        return self._head + "".join(self._parts)

    def clean(self) -> None:
        """Take out what makes cantools refuse the whole file, although it is of one message or signal, or of none."""
        self._drop_where("BO_", _wrong_identifier)
        self._drop_where(
            "SG_", lambda text: "" if _WHOLE_SIGNAL.fullmatch(text) else "it is not written as a signal is"
        )
        for keyword in _ENDED:
            self._drop_where(keyword, _unended)
        known = {match[1] for _, match in self._matches(("BA_DEF_",), _ATTRIBUTE)}
        self._drop_where("BA_", lambda text: _undefined(text, known))
        signals = set(self._signals())
        for keyword in ("VAL_", "SIG_VALTYPE_"):
            self._drop_where(keyword, lambda text: _of_nothing(text, signals))

    def end(self) -> None:
        """Take out the last statement where the file ends within it, which cantools passes over in silence."""
        number = len(self._parts) - 1
        keyword, text = (self._keywords[number], _COMMENT.sub("", self._parts[number])) if self._parts else ("", "")
        whole = {"SG_": _WHOLE_SIGNAL, "BO_": _WHOLE_MESSAGE}.get(keyword)
        if whole is None and (keyword in ("", *_UNMARKED) or not _unended(text)):
            return
        if whole and not whole.fullmatch(text) and not (_SIGNAL if keyword == "SG_" else _MESSAGE).match(text):
            self._blank(number)
            self.notes.append("the file ends within the name of a message or signal, which is left out")
        elif whole is None or not whole.fullmatch(text):
            self._drop(number, "the file ends within it")

    def without(self, offset: int, why: str) -> bool:
        """Whether a statement is there, which is taken out for this reason."""
        number = bisect_right(self._begins, offset) - 1
        if number < 0 or not self._parts[number].strip():
            return False
        self._drop(number, why)
        return True

    def without_attributes(self, why: str) -> bool:
        """Whether there were attributes, which are taken out for this reason."""
        chosen = [n for n, part in enumerate(self._parts) if self._keywords[n].startswith("BA_") and part.strip()]
        for number in chosen:
            self._blank(number)
        self.notes += [f"no attributes are read: {why}"] if chosen else []
        return bool(chosen)

    def _drop_where(self, keyword: str, wrong: Callable[[str], str]) -> None:
        for number, own in enumerate(self._keywords):
            text = self._parts[number]
            if own == keyword and text.strip() not in ("", keyword) and (why := wrong(text)):
                self._drop(number, why)

    def _drop(self, number: int, why: str) -> None:
        """Take a statement out; what says how a message is decoded goes with all of the message."""
        keyword, text = self._keywords[number], self._parts[number]
        about = _ABOUT.match(text) if keyword in ("SG_MUL_VAL_", "SIG_VALTYPE_") else None
        self._blank(number)
        if about and about[1] in self._messages:
            self._drop_message(self._messages[about[1]], why)
        elif keyword == "BO_":
            self._drop_message(number, why, text)
        elif keyword == "SG_":
            self._drop_signal(number, why, text)
        elif not about:
            line = self.text.count("\n", 0, self._begins[number]) + 1
            self.notes.append(f"line {line}, {' '.join(text.split())[:60]}, is left out: {why}")

    def _drop_signal(self, number: int, why: str, text: str) -> None:
        owner = next((n for n in range(number, -1, -1) if self._keywords[n] == "BO_"), number)
        message, signal = _MESSAGE.match(self._parts[owner]), _SIGNAL.match(text)
        if message and signal and not (signal[2] or "").endswith("M"):
            self.left_out.append(LeftOut(message[2], why, (signal[1],), whole=False))
        elif message:
            self._drop_message(owner, why)

    def _drop_message(self, number: int, why: str, text: str = "") -> None:
        message = _MESSAGE.match(text or self._parts[number])
        end = next((n for n in range(number + 1, len(self._parts)) if self._keywords[n] != "SG_"), len(self._parts))
        signals = [match[1] for part in self._parts[number + 1 : end] if (match := _SIGNAL.match(part))]
        for inside in (*range(number, end), *(self._about.get(message[1], ()) if message else ())):
            self._blank(inside)
        if message:
            self.left_out.append(LeftOut(message[2], why, tuple(signals)))

    def _signals(self) -> Iterator[tuple[str, str]]:
        """Identifier of the message and name of each signal."""
        identifier = ""
        for keyword, part in zip(self._keywords, self._parts, strict=True):
            if keyword == "BO_" and (message := _MESSAGE.match(part)):
                identifier = message[1]
            elif keyword == "SG_" and (signal := _SIGNAL.match(part)):
                yield identifier, signal[1]

    def _matches(self, keywords: tuple[str, ...], pattern: re.Pattern[str]) -> Iterator[tuple[int, re.Match[str]]]:
        for number, keyword in enumerate(self._keywords):
            if keyword in keywords and (match := pattern.match(self._parts[number])):
                yield number, match

    def _blank(self, number: int) -> None:
        self._parts[number] = re.sub(r"[^\n]", " ", self._parts[number])


def _blank(found: re.Match[str]) -> str:
    return re.sub(r"[^\n]", " ", found[0])


def _wrong_identifier(text: str) -> str:
    match = _MESSAGE.match(text)
    if match is None or match[2] == _UNSENT:
        return ""
    identifier = int(match[1][:12])
    if -(1 << 31) <= identifier < 0:  # as tools write it that take it for a number with a sign
        identifier &= 0xFFFFFFFF
    limit, bits = (0x9FFFFFFF, "29 bits") if identifier >> 31 else (0x7FF, "11 bits, and is not marked as extended")
    wrong = identifier < 0 or identifier > limit
    return f"its identifier 0x{identifier & 0x7FFFFFFF:X} has more than {bits}" if wrong else ""


def _unended(text: str) -> str:
    return "" if STRINGS.sub("", text).rstrip().endswith(";") else "it does not end"


def _undefined(text: str, known: set[str]) -> str:
    match = _ATTRIBUTE.match(text)
    return f"the attribute {match[1]} is not defined" if match and match[1] not in known else ""


def _of_nothing(text: str, signals: set[tuple[str, str]]) -> str:
    match = _ABOUT.match(text)
    return "there is no such signal" if match and match.groups() not in signals else ""
