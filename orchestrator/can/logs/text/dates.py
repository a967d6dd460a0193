"""The date with which a log begins, as tools write it in several languages."""

from __future__ import annotations

import re
import unicodedata
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

MONTHS = (
    "jan ene gen",
    "feb fev",
    "mar mrz maa",
    "apr avr abr",
    "may mai mei mag",
    "jun juin giu",
    "jul juil lug",
    "aug aou ago",
    "sep set",
    "oct okt ott out",
    "nov",
    "dec dez dic",
)
NUMBERS = {name: number for number, names in enumerate(MONTHS, 1) for name in names.split()}
CLOCK = re.compile(r"(\d{1,2}):(\d{1,2}):(\d{1,2})(?:[.,:](\d{1,9}))?\s*([ap]m\b)?", re.IGNORECASE)
ISO = re.compile(r"(\d{4})-(\d\d)-(\d\d)[T ](\d\d:\d\d:\d\d(?:[.,]\d+)?)\s*(Z|[+-]\d\d:?\d\d)?", re.IGNORECASE)
DAY_FIRST = re.compile(r"(\d{1,2})[.:/](\d{1,2})[.:/](\d{4})\s+(.*)")


class Moment(NamedTuple):
    """POSIX time, and whether it was said in which time zone."""

    time: float
    zone: bool


def moment(text: str) -> Moment | None:
    """The moment that a date means, in UTC where no zone is told; None where it is not understood."""
    try:
        return _iso(text) or _day_first(text) or _in_words(text)
    except (ValueError, OverflowError):
        return None


def _iso(text: str) -> Moment | None:
    told = ISO.search(text)
    if told is None:
        return None
    time = _at(int(told[1]), int(told[2]), int(told[3]), told[4])
    if told[5] and told[5].upper() != "Z":
        sign, hours, minutes = told[5][0], int(told[5][1:3]), int(told[5][-2:])
        time -= (1 if sign == "+" else -1) * (3600 * hours + 60 * minutes)
    return Moment(time, bool(told[5]))


def _day_first(text: str) -> Moment | None:
    told = DAY_FIRST.search(text)
    return Moment(_at(int(told[3]), int(told[2]), int(told[1]), told[4]), False) if told else None


def _in_words(text: str) -> Moment | None:
    """Weekday, month and day or day and month, time, year: `Thu Mar 07 09:20:11.250 am 2024`."""
    plain = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode().lower()
    year = re.search(r"\b\d{4}\b", CLOCK.sub(" ", plain))
    days = re.findall(r"\b\d{1,2}\b", CLOCK.sub(" ", plain))
    words = re.findall(r"[a-z]+", plain)  # the first is the day of the week, which may look like a month
    months = [number for word in words[1:] + words[:1] if (number := NUMBERS.get(word[:4]) or NUMBERS.get(word[:3]))]
    if year is None or len(days) != 1 or not months:
        return None
    return Moment(_at(int(year[0]), months[0], int(days[0]), plain), False)


def _at(year: int, month: int, day: int, clock: str) -> float:
    told = CLOCK.search(clock)
    if told is None:
        raise ValueError(clock)
    hour, minute, second = int(told[1]), int(told[2]), int(told[3])
    if told[5]:
        hour = hour % 12 + 12 * (told[5].lower() == "pm")
    fraction = int(told[4].ljust(9, "0")) / 1e9 if told[4] else 0.0
    day_time = timedelta(hours=hour, minutes=minute, seconds=second)
    return (datetime(year, month, day, tzinfo=UTC) + day_time).timestamp() + fraction
