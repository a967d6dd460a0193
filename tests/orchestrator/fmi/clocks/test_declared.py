"""What FMUs declare of their clocks is read exactly, and refused where it contradicts itself."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import pytest

from fmus.errors import FmuFileError
from fmus.packaging import archive
from orchestrator.fmi.clocks.declared import Clock, TickInterval
from orchestrator.fmi.file import FmuDescription
from tests.support.fmus.clocks import CLOCKS, description


def declared(folder: Path, text: str) -> dict[str, Clock]:
    archive.write(folder / "d.fmu", {"modelDescription.xml": text.encode()})
    return dict(FmuDescription(folder / "d.fmu").interface.clocks)


def test_all_kinds_of_clocks_are_read(tmp_path: Path) -> None:
    found = declared(tmp_path, description(CLOCKS))
    assert {name: str(clock.kind) for name, clock in found.items()} == {
        name: text.partition('intervalVariability="')[2].partition('"')[0] for name, text in CLOCKS.items()
    }
    assert found["tick"] == Clock("tick", 1, "input", TickInterval.CONSTANT, Fraction(1, 10))
    assert [name for name, clock in found.items() if clock.timed] == ["tick", "changing", "countdown", "tune", "fixed"]


@pytest.mark.parametrize(
    ("said", "interval", "shift"),
    [
        ('intervalVariability="constant" intervalDecimal="1e-3" shiftDecimal="2.5e-4"', "1/1000", "1/4000"),
        ('intervalVariability="constant" resolution="3" intervalCounter="1" shiftCounter="2"', "1/3", "2/3"),
        ('intervalVariability="constant" resolution="3" intervalCounter="1" intervalDecimal="0.3333333"', "1/3", "0"),
        ('declaredType="Slow"', "1/2", "0"),
        ('declaredType="Slow" intervalCounter="1"', "1/10", "0"),
    ],
    ids=["decimal", "counter", "both", "type", "over its type"],
)
def test_intervals_are_exact(tmp_path: Path, said: str, interval: str, shift: str) -> None:
    clock = declared(tmp_path, description({"tick": said}))["tick"]
    assert (clock.interval, clock.shift) == (Fraction(interval), Fraction(shift))


@pytest.mark.parametrize(
    ("name", "said", "problem"),
    [
        ("tick", "", "has no intervalVariability; give constant, fixed"),
        ("tick", 'intervalVariability="hourly"', "has the intervalVariability 'hourly'; give"),
        ("tick", 'intervalVariability="constant"', "is constant and has no interval; give intervalDecimal or"),
        ("tick", 'intervalVariability="constant" intervalDecimal="0"', "has the interval 0 s; give one above 0"),
        ("tick", 'intervalVariability="constant" intervalDecimal="-0.1"', "has the interval -0.1 s"),
        ("tick", 'intervalVariability="constant" intervalDecimal="soon"', "intervalDecimal='soon' is no number"),
        ("tick", 'intervalVariability="constant" intervalCounter="5"', "intervalCounter='5' and no resolution"),
        ("tick", 'intervalVariability="fixed" intervalCounter="5" resolution="0"', "has the resolution 0"),
        ("tick", 'intervalVariability="tunable" shiftDecimal="-1"', "has the shift -1 s"),
        (
            "tick",
            'intervalVariability="constant" intervalDecimal="0.1" intervalCounter="2" resolution="10"',
            "has the interval 0.1 s by its decimal and 0.2 s by its counter; make them agree",
        ),
        ("trigger", 'intervalVariability="triggered" intervalDecimal="1"', "is triggered and has an interval"),
        ("out", 'intervalVariability="constant" intervalDecimal="1"', "is an output and ticks by time .constant."),
    ],
)
def test_contradictions_are_refused_by_their_place(tmp_path: Path, name: str, said: str, problem: str) -> None:
    with pytest.raises(FmuFileError, match=rf"d\.fmu: {name}: .*{problem}"):
        declared(tmp_path, description({name: said}))


def test_a_variable_that_belongs_to_what_is_no_clock_is_refused(tmp_path: Path) -> None:
    text = description({"trigger": CLOCKS["trigger"]}).replace('clocks="5"', 'clocks="22"')
    with pytest.raises(FmuFileError, match=r"d\.fmu: w: belongs to the clock 'divisor', which is a Float64; correct"):
        declared(tmp_path, text)
