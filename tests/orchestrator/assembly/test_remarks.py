"""What is said of a component that is left to itself in a system."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.packaging import archive
from orchestrator.assembly.assembly import ComponentSpec, open_system
from orchestrator.assembly.remarks import remarks, sampling
from orchestrator.assembly.wiring import wire
from orchestrator.fmi.interface import Interface, Port
from orchestrator.system import Part
from tests.support.simulation.ssps import gain


def controller(start: str = "0.0033333333333333335", unit: str = "s") -> Interface:
    port = Port("sample_time", 1, "Real", "parameter", unit, start)
    return Interface("controller", "2.0", {port.name: port}, {})


@given(st.fractions(Fraction(1, 10**5), Fraction(1), max_denominator=10**5), st.integers(1, 1000))
def test_a_period_of_whole_steps_is_nothing_to_speak_of(step: Fraction, whole: int) -> None:
    assert sampling(controller(), {"sample_time": float(f"{float(step * whole):.15g}")}, step) is None


@given(st.fractions(Fraction(1, 10**5), Fraction(1), max_denominator=10**5), st.integers(0, 1000))
def test_one_that_ends_within_a_step_is_told_with_both(step: Fraction, whole: int) -> None:
    period = float(step * (whole + Fraction(1, 3)))
    remark = sampling(controller(), {"sample_time": period}, step)
    assert remark is not None and f"{period:.6g} s" in remark and f"{float(step):.6g} s" in remark


def test_the_default_of_the_fmu_counts_and_another_unit_does_not() -> None:
    assert sampling(controller(), {}, Fraction(1, 300)) is None
    assert sampling(controller(), {}, Fraction(1, 1000)) is not None
    assert sampling(controller(unit="ms"), {}, Fraction(1, 1000)) is None


def test_what_a_description_may_not_mean_is_told_of_what_nobody_gives_a_value(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    files = archive.read(gain())
    text = files["modelDescription.xml"].decode()
    odd = text.replace('<Real start="1.0" />', "<Real />").replace('<Real start="2.0" />', '<Real start="2" max="1" />')
    archive.write(tmp_path / "odd.fmu", {**files, "modelDescription.xml": odd.encode()})
    for name, parameters in (("left", {}), ("given", {"k": 0.5})):
        spec = ComponentSpec(tmp_path / "odd.fmu", parameters)
        with open_system({name: spec}, stimulated=[f"{name}.u"]) as system:
            trace = system.run(1, 1, stimuli={f"{name}.u": 3.0}).trace
            assert trace[f"{name}.y"][-1] == 3 * parameters.get("k", 2)
    assert "left: k starts from 2, outside its bounds (-inf, 1]: give it a value inside" in caplog.text
    assert "given: " not in caplog.text and "u has no start value" not in caplog.text


@pytest.mark.parametrize(("step", "told"), [("1/1000", True), ("1/300", False), ("1/900", False)])
def test_a_run_says_it_of_the_step_that_the_component_has(
    step: str, told: bool, caplog: pytest.LogCaptureFixture
) -> None:
    name = f"pd_{step.partition('/')[2]}"
    with open_system({name: ComponentSpec("pd", step=Fraction(step))}) as system:
        system.run(0.1, "1/100" if step != "1/900" else "1/300")
    assert any(name in line and "no whole number of its steps" in line for line in caplog.messages) is told


@pytest.mark.parametrize(
    ("source", "items", "told"),
    [
        ("a.m", {"slow": 1, "fast": 2}, ""),
        ("a.m", {"slow": 1, "fast": 2, "off": 3}, ""),
        ("a.m", {"fast": 1, "slow": 2}, "1 is 'slow' there and 'fast' here; 2 is 'fast' there and 'slow' here"),
        ("a.m", {"slow": 1}, "2 is 'fast' there and none here"),
        ("-1 * a.m + 3", {"fast": 1, "slow": 2}, ""),
    ],
)
def test_enumerations_that_call_their_numbers_otherwise_are_told(source: str, items: dict[str, int], told: str) -> None:
    def one(name: str, causality: str, own: dict[str, int]) -> Part:
        port = Port(name, 1, "Enumeration", causality, None, "1", items=own)
        return Part(Interface(name, "2.0", {name: port}, {}))

    parts = {"a": one("m", "output", {"slow": 1, "fast": 2}), "b": one("q", "input", items)}
    said = remarks(wire(parts, [(source, "b.q")]), "b", ())
    assert said == ([f"q takes the numbers of a.m, not its items: {told}"] if told else [])
