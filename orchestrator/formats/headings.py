"""Column headings: `name [unit]`, written and read back, and those that others write."""

from __future__ import annotations

import re

from fmus.errors import TraceError
from fmus.units import parse
from orchestrator.trace import Trace

SECONDS = {
    "": 1.0,
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds", "Sekunden", "秒"), 1.0),
    **dict.fromkeys(("ms", "毫秒"), 1e-3),
    **dict.fromkeys(("us", "µs", "μs"), 1e-6),
    "ns": 1e-9,
    "min": 60.0,
    "h": 3600.0,
    **dict.fromkeys(("d", "days"), 86400.0),
}
"""Unit of time -> seconds."""

_TIME = re.compile(
    r"(?:(?:rel|abs|elapsed|relative|absolute)[ _.]?)?"
    r"(?:time|tout|(?-i:t)|zeit|time[ _]?stamps?|zeitstempel|uhrzeit|date[ _]?time|x_value|x-?axis|temps|tiempo|tempo"
    r"|czas|čas|время|时间|時間)"
    r"(?:[ _](?P<unit>s|sec|ms|us|µs|ns|min|h))?",
    re.IGNORECASE,
)
_TOLD = (
    re.compile(r"(?P<name>.*?)(?:\s+|(?<!\s)(?!\[\d+\]$))\[(?P<unit>[^\[\]]*)\]"),
    re.compile(r"(?P<name>.*\S)\s*\((?P<sure>[^()]*)\)"),
    re.compile(r"(?P<name>.*\S)\s+(?:/|in)\s+(?P<sure>\S+)"),
    re.compile(r"(?P<name>.*\S),\s*(?P<sure>\S+)"),
)


def split(heading: str) -> tuple[str, str]:
    """Name and unit ("" when there is none) of a heading: `n [rpm]`, `n (rpm)`, `n / rpm`, `n in rpm`, `n, rpm`."""
    text = " ".join(heading.split())
    for form in _TOLD:
        found = form.fullmatch(text)
        if found and found["name"].strip():
            unit = found.groupdict().get("unit")
            if unit is not None:
                return found["name"].rstrip(), unit.strip()
            if is_unit(found["sure"].strip()):
                return found["name"].rstrip(), found["sure"].strip()
    return text, ""


def bare(cell: str) -> str:
    """A unit without the brackets that may be around it."""
    text = cell.strip()
    return text[1:-1].strip() if text[:1] + text[-1:] in ("[]", "()", "<>") else text


def is_unit(text: str) -> bool:
    """Whether a text is surely a unit."""
    return bool(text) and (
        parse(text) is not None or text in SECONDS or text in ("-", "Nm") or bool(set("°%") & set(text))
    )


def names_time(heading: str) -> bool:
    """Whether a heading names the time stamps."""
    name = split(heading.lstrip("# "))[0]
    return _TIME.fullmatch(re.split(r"[./]", name)[-1]) is not None


def time_unit(name: str) -> str:
    """The unit in such a name, as in `time_ms`; "" without."""
    found = _TIME.fullmatch(name)
    return ((found and found["unit"]) or "").lower()


def joined(name: str, unit: str) -> str:
    """The heading of a column; `split` gives name and unit back.

    Raises:
        TraceError: they would not come back, or would not fit on one line.
    """
    heading = f"{name} [{unit}]" if unit or split(name) != (name, "") else name
    if split(heading) != (name, unit) or not name or heading.splitlines() != [heading]:
        raise TraceError(
            repr(name), f"with unit '{unit}' cannot be a column heading", "rename the signal or write .parquet"
        )
    return heading


def headings(trace: Trace) -> list[str]:
    """One heading a column of the written file, time first."""
    return ["time [s]", *(joined(name, trace.unit(name) or "") for name in trace.names)]
