"""What unit symbols mean, and how else they are written: plain tables for `fmus.units`."""

from __future__ import annotations

import math

TURN = 2 * math.pi

PREFIXES = {
    "p": 1e-12,
    "n": 1e-9,
    "u": 1e-6,
    "μ": 1e-6,
    "m": 1e-3,
    "c": 1e-2,
    "d": 1e-1,
    "h": 1e2,
    "k": 1e3,
    "M": 1e6,
    "G": 1e9,
}

PREFIXED: dict[str, tuple[float, str]] = {
    "m": (1.0, "m"),
    "g": (1e-3, "kg"),
    "s": (1.0, "s"),
    "A": (1.0, "A"),
    "K": (1.0, "K"),
    "mol": (1.0, "mol"),
    "rad": (1.0, "rad"),
    "deg": (TURN / 360, "rad"),
    "N": (1.0, "kg.m/s2"),
    "J": (1.0, "kg.m2/s2"),
    "W": (1.0, "kg.m2/s3"),
    "Pa": (1.0, "kg/m.s2"),
    "bar": (1e5, "kg/m.s2"),
    "V": (1.0, "kg.m2/s3.A"),
    "Ohm": (1.0, "kg.m2/s3.A2"),
    "S": (1.0, "s3.A2/kg.m2"),
    "H": (1.0, "kg.m2/s2.A2"),
    "F": (1.0, "s4.A2/kg.m2"),
    "C": (1.0, "A.s"),
    "T": (1.0, "kg/s2.A"),
    "Wb": (1.0, "kg.m2/s2.A"),
    "Hz": (1.0, "1/s"),
    "rpm": (TURN / 60, "rad/s"),
    "l": (1e-3, "m3"),
    "L": (1e-3, "m3"),
}
"""Symbols that take a prefix: factor and definition."""

PLAIN: dict[str, tuple[float, str]] = {
    "kg": (1.0, "kg"),
    "cd": (1.0, "cd"),
    "t": (1e3, "kg"),
    "min": (60.0, "s"),
    "h": (3600.0, "s"),
    "rev": (TURN, "rad"),
    "gon": (TURN / 400, "rad"),
    "%": (1e-2, "1"),
    "ppm": (1e-6, "1"),
    "PS": (735.49875, "kg.m2/s3"),
    "kgf": (9.80665, "kg.m/s2"),
    "in": (0.0254, "m"),
    "ft": (0.3048, "m"),
    "mph": (0.44704, "m/s"),
    "lb": (0.45359237, "kg"),
    "oz": (0.45359237 / 16, "kg"),
    "lbf": (0.45359237 * 9.80665, "kg.m/s2"),
    "ozf": (0.45359237 * 9.80665 / 16, "kg.m/s2"),
    "psi": (0.45359237 * 9.80665 / 0.0254**2, "kg/m.s2"),
    "atm": (101325.0, "kg/m.s2"),
}
"""Symbols that take none."""

OFFSETS = {"degC": (1.0, 273.15), "degF": (5 / 9, 459.67 * 5 / 9)}
"""Temperatures: factor and offset to K."""

WORDS = {
    "sec": "s",
    "msec": "ms",
    "usec": "us",
    "second": "s",
    "seconds": "s",
    "minute": "min",
    "minutes": "min",
    "hr": "h",
    "hour": "h",
    "hours": "h",
    "meter": "m",
    "metre": "m",
    "meters": "m",
    "metres": "m",
    "degree": "deg",
    "degrees": "deg",
    "deg": "deg",
    "rad": "rad",
    "radian": "rad",
    "radians": "rad",
    "turn": "rev",
    "turns": "rev",
    "rev": "rev",
    "revs": "rev",
    "volt": "V",
    "volts": "V",
    "amp": "A",
    "amps": "A",
    "ampere": "A",
    "amperes": "A",
    "watt": "W",
    "watts": "W",
    "newton": "N",
    "newtons": "N",
    "kelvin": "K",
    "celsius": "degC",
    "degc": "degC",
    "fahrenheit": "degF",
    "degf": "degF",
    "ohm": "Ohm",
    "ohms": "Ohm",
    "inch": "in",
    "percent": "%",
    "rpm": "rpm",
    "hz": "Hz",
    "kg": "kg",
    "bar": "bar",
}
"""Words and other spellings of symbols, in small letters."""

WHOLE = {
    "-": "1",
    "/min": "rpm",
    "1/min": "rpm",
    "min-1": "rpm",
    "min^-1": "rpm",
    "U/min": "rpm",
    **dict.fromkeys(("r/min", "tr/min", "giri/min", "obr/min", "ot/min", "об/мин", "转/分", "转/分钟"), "rpm"),
    "U/s": "rev/s",
    "r/s": "rev/s",
    "rps": "rev/s",
    "dps": "deg/s",
    "deg C": "degC",
    "deg F": "degF",
    **dict.fromkeys(("oz-in", "oz.in", "in-oz", "in.oz", "ozin"), "ozf.in"),
    **dict.fromkeys(("lb-in", "lb.in", "in-lb", "in.lb"), "lbf.in"),
    **dict.fromkeys(("lb-ft", "lb.ft", "ft-lb", "ft.lb"), "lbf.ft"),
    "kph": "km/h",
    "kmh": "km/h",
}
"""Names that mean something else than their parts, or nothing by them: turns a minute above all."""

UNSURE = frozenset({"Grad", "grad"})
"""Neither thousand millions of radians nor surely degrees (German) or gon (French)."""

SIGNS = {"°C": "degC", "°F": "degF", "°": "deg", "Ω": "Ohm", "−": "-", "**": "^"} | dict.fromkeys("·⋅∙•×*", ".")
"""Signs and what they are written by here."""

HEADS = ("kg", "g", "N", "W", "V", "A", "J", "Pa", "Nm")
TAILS = ("cm", "mm", "m", "s", "h", "A")
"""Symbols, with or without a prefix, and those that follow some of them without a dot between."""
