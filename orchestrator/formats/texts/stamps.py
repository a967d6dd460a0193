"""Dates and times of day, as texts have them, in seconds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import compute

from fmus.errors import TraceError
from orchestrator.formats.layout import Dates
from orchestrator.formats.stamps import Stamps, since_first
from orchestrator.formats.texts.cells import BASIC, EXTENDED, SHORT, STAMP

Whole = NDArray[np.int64]
DAY, HOUR = 86_400 * 10**9, 3600 * 10**9  # [ns]
MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")


def seconds(column: pa.ChunkedArray, order: Dates | None, zone: str | None, place: Path) -> Stamps:
    """The instants that a column of texts (K,) tells, in seconds since the first.

    Args:
        order: of day, month and year; None sees it where it can be seen.
        zone: where the clock was, for texts that do not say it.

    Raises:
        TraceError: a text is no time, or the dates may be read two ways.
    """
    texts = compute.replace_substring_regex(column.combine_chunks(), BASIC, EXTENDED)
    short = compute.match_substring_regex(texts, SHORT)
    whole = compute.binary_join_element_wise("00", compute.utf8_trim_whitespace(texts), ":")
    texts = compute.if_else(short, whole, texts)
    found = compute.extract_regex(texts, STAMP)
    bad = compute.and_(found.is_null(), texts.is_valid())
    if compute.any(bad).as_py():
        row = compute.index(bad, True).as_py()
        raise TraceError(place, f"time stamp {row + 1} is '{str(texts[row])[:40]}', no time", "correct or cut that row")
    if found.null_count:
        row = compute.index(found.is_null(), True).as_py()
        raise TraceError(place, f"time stamp {row + 1} is missing", "drop those rows, or check the time column")
    clock = _clock(found, place)
    if not compute.any(compute.not_equal(found.field("a"), "")).as_py():
        return _going_on(clock, HOUR if compute.all(short).as_py() else DAY)
    days, notes = _days(found, order, place)
    if compute.any(compute.match_substring_regex(found.field("finer"), "[1-9]")).as_py():
        notes.append("its times are cut at nanoseconds")
    zones = found.field("zone")
    instants = days * DAY + clock - _offsets(zones)
    if compute.any(compute.equal(zones, "")).as_py():
        if compute.any(compute.not_equal(zones, "")).as_py():
            raise TraceError(place, "some of its times name a zone and some do not", "write them alike")
        return since_first(instants, zone, place, tuple(notes))
    return since_first(instants, "UTC", place, tuple(notes))


def _clock(found: Any, place: Path) -> Whole:
    hour, minute, second = (_whole(found.field(part)) for part in ("hour", "minute", "second"))
    half = compute.utf8_upper(found.field("half"))
    twelve, after = (compute.not_equal(half, ""), compute.starts_with(half, "P"))
    hour = np.where(_flags(twelve), hour % 12 + 12 * _flags(after), hour)
    if np.any((hour > 24) | (minute > 59) | (second > 60)):
        raise TraceError(place, "has a time that no clock shows", "check the time column")
    fraction = _whole(compute.utf8_rpad(found.field("fraction"), 9, "0"))
    return _whole(found.field("days")) * DAY + ((hour * 60 + minute) * 60 + second) * 10**9 + fraction


def _going_on(clock: Whole, period: int) -> Stamps:
    """Times of day without a date, or of an hour; half of that backwards is where it begins anew."""
    passed = np.append(0, np.cumsum(np.diff(clock) < -period // 2))
    instants = clock + passed * period
    day = period == DAY
    notes = (f"its times pass {'midnight' if day else 'the hour'} {passed[-1]} times",) if passed[-1] else ()
    since = "its times of day" if day else "its minutes and seconds"
    return Stamps((instants - instants[0]) / 1e9, None, (f"{since} count from the first", *notes))


def _days(found: Any, order: Dates | None, place: Path) -> tuple[Whole, list[str]]:
    """(K,) days since 1970, and how the dates were read."""
    first, third = (_whole(found.field(part)) for part in ("a", "c"))
    middle = found.field("b")
    named = compute.any(compute.match_substring_regex(middle, "[A-Za-z]")).as_py()
    second = _months(middle, place) if named else _whole(middle)
    notes: list[str] = []
    if order is None:
        order = _order(first, second, third, named, str(found.field("mark")[0]), place)
        notes = [f"its dates are read as {order}"] if order != "ymd" else []
    year, month, day = {
        "ymd": (first, second, third),
        "dmy": (third, second, first),
        "mdy": (third, first, second),
    }[order]
    year = np.where(year < 100, year + 2000, year)
    if np.any((year < 1900) | (year > 2200) | (month < 1) | (month > 12) | (day < 1) | (day > 31)):
        raise TraceError(place, f"has a date that is none as {order}", "say `dates`: dmy, mdy or ymd")
    months = ((year - 1970) * 12 + month - 1).astype("datetime64[M]")
    dates = months.astype("datetime64[D]") + (day - 1).astype("timedelta64[D]")
    if np.any(dates.astype("datetime64[M]") != months):
        raise TraceError(place, "has a date that is in no calendar", "check the time column")
    return dates.astype(np.int64), notes


def _order(first: Whole, second: Whole, third: Whole, named: bool, mark: str, place: Path) -> Dates:
    if first.min() > 31:
        return "ymd"
    if third.min() > 31:
        if named or first.max() > 12 or (mark == "." and second.max() <= 12):
            return "dmy"
        if second.max() > 12:
            return "mdy"
    text = f"{first[0]:02}{mark}{second[0]:02}{mark}{third[0]:02}"
    raise TraceError(place, f"its dates, such as {text}, may be read two ways", "say `dates`: dmy, mdy or ymd")


def _months(texts: Any, place: Path) -> Whole:
    numbers = compute.index_in(compute.utf8_lower(texts), value_set=pa.array(MONTHS))
    if numbers.null_count:
        raise TraceError(place, "has a month that is not known", f"write {', '.join(MONTHS)} or numbers")
    return _whole(numbers) + 1


def _offsets(zones: Any) -> Whole:
    """(K,) ns that local clocks are ahead."""
    ahead = {
        zone: 0
        if zone in ("", "Z", "UTC")
        else int(zone[0] + "1") * (int(zone[1:3]) * 60 + int(zone[-2:])) * 60 * 10**9
        for zone in compute.unique(zones).to_pylist()
    }
    names = pa.array(list(ahead))
    return np.array(list(ahead.values()), dtype=np.int64)[_whole(compute.index_in(zones, value_set=names))]


def _whole(numbers: Any) -> Whole:
    if pa.types.is_string(numbers.type):
        numbers = compute.if_else(compute.equal(numbers, ""), "0", numbers)
    return np.asarray(compute.cast(numbers, pa.int64()).to_numpy(zero_copy_only=False), dtype=np.int64)


def _flags(values: Any) -> NDArray[np.bool_]:
    return np.asarray(values.to_numpy(zero_copy_only=False), dtype=bool)
