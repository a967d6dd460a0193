"""Lines of text as arrays of octets: their words and fields, and the numbers in these, for all lines at once.

Whatever does not look as it should is not `sound`, and is left to whoever reads it line by line.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from orchestrator.can.log_suffixes import PLAIN
from orchestrator.trace import BoolArray, Bytes, FloatArray

Positions = NDArray[np.int64]

SLACK = 256  # octets before and behind the text, so that what is near a word can be looked at
NEAR = 80  # pieces behind the last, so that one that is not there can be asked for
NEWLINE, BLANK, DOT = 10, 32, 46
DIGIT = np.full(256, 255, np.uint8)  # value of a character as a digit
for _value, _digit in enumerate("0123456789abcdef"):
    DIGIT[[ord(_digit), ord(_digit.upper())]] = _value
BESIDE = (np.arange(256) <= BLANK) | (np.arange(256) == ord('"'))
ODD_BLANKS = re.compile(r"[^\S ]")  # they separate nothing
EXACT, FEW_DIGITS, LONGEST_NUMBER = 1 << 53, 17, 24  # whole numbers that a double holds; characters
POWERS = 10.0 ** np.arange(23)


class TextField(NamedTuple):
    """Where a piece of each line begins, and ends (the position behind it)."""

    begin: Positions
    end: Positions

    @property
    def length(self) -> Positions:
        return self.end - self.begin

    def of(self, rows: Positions) -> TextField:
        """Of these lines only."""
        return TextField(self.begin[rows], self.end[rows])

    def without(self, front: int | BoolArray | Positions, back: int | BoolArray | Positions = 0) -> TextField:
        """Less so many octets at either side."""
        return TextField(self.begin + front, self.end - back)


@dataclass(frozen=True)
class TextPieces:
    """The words or fields of lines one after the other: those of a line begin with its `first`."""

    all: TextField
    first: Positions
    count: Positions

    def __getitem__(self, number: int | Positions) -> TextField:
        """The piece with this number in each line, an empty one at its end where there are not so many."""
        place = self.first + (number if isinstance(number, int) and number < NEAR else np.minimum(number, self.count))
        begin, end = self.all.begin[place], self.all.end[place]
        return TextField(begin, np.where((number >= 0) & (number < self.count), end, begin))


class TextLines:
    """Lines of a text.

    Attributes:
        octets: the text between `SLACK` octets of nothing.
        whole: the lines, without their ends.
    """

    def __init__(self, octets: Bytes, whole: TextField) -> None:
        self.octets, self.whole = octets, whole

    def __len__(self) -> int:
        return len(self.whole.begin)

    def __getitem__(self, rows: slice) -> TextLines:
        """Some of the lines."""
        return TextLines(self.octets, TextField(self.whole.begin[rows], self.whole.end[rows]))

    def text(self, row: int) -> str:
        """A line, as UTF-8 where it is."""
        raw = self.octets[self.whole.begin[row] : self.whole.end[row]].tobytes().translate(PLAIN)
        try:
            text = raw.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = raw.decode("latin-1")
        return ODD_BLANKS.sub("\ufffd", text).strip()

    @cached_property
    def words(self) -> TextPieces:
        """What stands between blanks."""
        first, last = self._bounds
        dark = np.concatenate(([False], self.octets[first:last] > BLANK, [False]))
        edges = np.flatnonzero(dark[1:] != dark[:-1]) + first
        return self._pieces(TextField(edges[0::2], edges[1::2]))

    def fields(self, separator: str) -> TextPieces:
        """What stands between separators, without the blanks around it."""
        first, last = self._bounds
        text = self.octets[first : last + 1]
        cuts = np.flatnonzero((text == ord(separator)) | (text == NEWLINE)) + first
        return self._pieces(self.trimmed(TextField(np.concatenate(([first], cuts[:-1] + 1)), cuts)))

    def trimmed(self, field: TextField, most: int = 4) -> TextField:
        """Without some blanks and quotation marks around it."""
        begin, end = field
        for _ in range(most):
            front = BESIDE[self.octets[begin]] & (begin < end)
            back = BESIDE[self.octets[end - 1]] & (begin + front < end)
            if not (front.any() or back.any()):
                break
            begin, end = begin + front, end - back
        return TextField(begin, end)

    def starts(self, field: TextField) -> Bytes:
        """(n,) first octets, 0 where there is none."""
        return np.where(field.length > 0, self.octets[field.begin], 0).astype(np.uint8)

    def equal(self, field: TextField, *words: str) -> BoolArray:
        """(n,) which are one of these, in either case."""
        found = np.zeros(len(field.begin), bool)
        for word in words:
            same = field.length == len(word)
            for place, letter in enumerate(word):
                octet = self.octets[field.begin + place]
                same = same & ((octet == ord(letter.lower())) | (octet == ord(letter.upper())))
            found |= same
        return found

    def names(self, field: TextField, rows: BoolArray, most: int = 256) -> tuple[list[str], Positions]:
        """The different plain words in some rows, and (n,) which of them stands where, -1 in all other rows."""
        found: list[str] = []
        places, left = np.full(len(rows), -1), rows & (field.length > 0)
        while len(found) < most and left.any():
            row = int(np.argmax(left))
            name = self.octets[field.begin[row] : field.end[row]]
            same = left & (field.length == len(name))
            for place, octet in enumerate(name.tolist()):
                same &= self.octets[field.begin + place] == octet
            if name.max() < 128:
                places[same] = len(found)
                found.append(name.tobytes().decode("ascii"))
            left &= ~same
        return found, places

    def near(self, begin: Positions, width: int) -> Bytes:
        """(n, width) the octets from these places on."""
        window = np.ndarray((len(self.octets) - width,), f"V{width}", self.octets, strides=(1,))
        return np.asarray(window[begin].view(np.uint8).reshape(len(begin), width))

    def whole_numbers(self, field: TextField, base: int, most: int) -> tuple[Positions, BoolArray]:
        """(n,) numbers of at most so many digits, and which are sound."""
        length = field.length
        value, sound = np.zeros(len(length), np.int64), (length > 0) & (length <= most)
        for place in range(min(most, int(length.max(initial=0))), 0, -1):
            digit, inside = DIGIT[self.octets[field.end - place]], place <= length
            sound &= (digit < base) | ~inside
            value = np.where(inside, value * base + digit, value)
        return value, sound

    def decimals(self, field: TextField) -> tuple[FloatArray, BoolArray]:
        """(n,) numbers with a point, rounded as `float` does it, and which are sound."""
        length = field.length
        value, sound = np.zeros(len(length), np.int64), (length > 0) & (length <= LONGEST_NUMBER)
        behind, pointed = np.zeros(len(length), np.int64), np.zeros(len(length), bool)
        for place in range(min(LONGEST_NUMBER, int(length.max(initial=0))), 0, -1):
            octet, inside = self.octets[field.end - place], place <= length
            point, digit = inside & (octet == DOT), DIGIT[octet]
            sound &= (digit < 10) | ~inside | (point & ~pointed)
            pointed |= point
            value = np.where(inside & ~point, value * 10 + digit, value)
            behind += inside & ~point & pointed
        sound &= length > pointed
        number = value / POWERS[np.minimum(behind, 22)]
        inexact = np.flatnonzero(sound & ((length > FEW_DIGITS) | (value >= EXACT)))
        if len(inexact):
            number[inexact] = self._as_python_has_them(field.of(inexact))
        return number, sound

    def _as_python_has_them(self, field: TextField) -> FloatArray:
        near = self.near(field.end - LONGEST_NUMBER, LONGEST_NUMBER)
        there = np.arange(LONGEST_NUMBER) >= LONGEST_NUMBER - field.length[:, None]
        digits = np.where(there, near, ord("0")).astype(np.uint8)
        return digits.view(f"S{LONGEST_NUMBER}").ravel().astype(np.float64)

    def octet_words(self, first: int | Positions, count: Positions, base: int, width: int) -> tuple[Bytes, BoolArray]:
        """(n, width) the bytes in the words from `first` on, as many as `count` says, and which are sound."""
        if base == 16:
            begin = self.words[first].begin
            data, sound = self.octet_digits(begin, count, 3, width)
            return data, sound & (begin + 3 * count <= self.whole.end + 1)
        data, sound = np.zeros((len(self), width), np.uint8), count <= width
        for place in range(int(min(width, count.max(initial=0)))):
            value, right = self.whole_numbers(self.words[first + place], base, 3)
            there = place < count
            sound &= (right & (value < 256)) | ~there
            data[:, place] = np.where(there, value, 0)
        return data, sound

    def octet_digits(
        self, begin: Positions, count: Positions, stride: int, width: int, behind: str = " "
    ) -> tuple[Bytes, BoolArray]:
        """(n, width) bytes of two hexadecimal digits, and which are sound.

        Args:
            stride: from one byte to the next; what is between them is blank or `behind`.
        """
        near = self.near(begin, stride * width).reshape(len(begin), width, stride)
        high, low = DIGIT[near[:, :, 0]], DIGIT[near[:, :, 1]]
        there = np.arange(width) < count[:, None]
        sound = (count >= 0) & (count <= width) & (((high | low) < 16) | ~there).all(axis=1)
        for between in range(2, stride):
            sound &= ((near[:, :, between] <= BLANK) | (near[:, :, between] == ord(behind)) | ~there).all(axis=1)
        return np.asarray(np.where(there, high << 4 | low, 0), np.uint8), sound

    @property
    def _bounds(self) -> tuple[int, int]:
        return (int(self.whole.begin[0]), int(self.whole.end[-1])) if len(self) else (SLACK, SLACK)

    def _pieces(self, pieces: TextField) -> TextPieces:
        first = np.searchsorted(pieces.begin, self.whole.begin)
        behind = np.searchsorted(pieces.begin, self.whole.end, side="right")
        beyond = np.full(NEAR, self._bounds[1])
        padded = TextField(np.concatenate([pieces.begin, beyond]), np.concatenate([pieces.end, beyond]))
        return TextPieces(padded, first, behind - first)


def lines_of(text: bytes) -> TextLines:
    """The lines of a text that ends with one."""
    octets = np.frombuffer(b"".join([bytes(SLACK), text, bytes(SLACK)]), np.uint8)
    ends = np.flatnonzero(octets == NEWLINE)
    begins = np.concatenate(([SLACK], ends[:-1] + 1))
    return TextLines(octets, TextField(begins, ends))
