"""Clocks tick, and tick each other, in the compiled loop as in Python's: to the last bit and at every trouble."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.packaging import archive
from orchestrator import open_system
from orchestrator.assembly.assembly import ComponentSpec
from orchestrator.engine import Engine, Result, Run, RunFailed, Timing
from orchestrator.trace import Trace, joined
from tests.support.fmus import clocks
from tests.support.simulation.both_loops import BOTH, bits, needs_loop

pytestmark = needs_loop
KINDS = {
    "tick": 'intervalVariability="constant" resolution="7" intervalCounter="1" shiftDecimal="0.05"',
    "fixed": clocks.CLOCKS["fixed"],
    "out": clocks.CLOCKS["out"],
    "alarm": clocks.CLOCKS["alarm"],
}
TIMING = Timing(Fraction(1), Fraction(1, 10))
WIRES = ["a.last_time -> b.u", "a.gauge -> b.v", "b.sampled -> c.u"]
COUNT = 11


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return clocks.build(tmp_path_factory.mktemp("clocks"), KINDS)


def both(fmu: Path, timing: Timing, wires: list[str], **values: float) -> list[Result | RunFailed]:
    found: list[Result | RunFailed] = []
    own = {f"b.{name}": value for name, value in values.items()}
    for engine in BOTH:
        with open_system(dict.fromkeys("abc", fmu), wires, ["a.u", "a.v"]) as system:
            driven = {"a.u": np.arange(float(COUNT)), "a.v": np.sin(np.arange(float(COUNT)))}
            with system.simulation(replace(timing, engine=engine)) as simulation:
                count = len(simulation.instants())
                cut = {name: np.resize(samples, count) for name, samples in driven.items()}
                try:
                    simulation.run(own, cut)
                    found.append(simulation.run(own, cut))  # after a reset
                except RunFailed as failed:
                    found.append(failed)
    return found


@pytest.mark.parametrize("step", ["1/10", "1/3", "1/100", "1"])
@pytest.mark.parametrize("wires", [[], WIRES], ids=["alone", "wired"])
def test_both_loops_tick_alike(fmu: Path, step: str, wires: list[str]) -> None:
    one, other = both(fmu, replace(TIMING, step=Fraction(step)), wires, alarm_at=0.625, event_at=0.3)
    assert isinstance(one, Result) and isinstance(other, Result)
    assert (one.account.engine, other.account.engine) == BOTH
    assert bits(one.trace) == bits(other.trace)
    assert one.trace["b.n_tick"][-1] == 7  # at 0.05 s and each seventh of a second after it
    assert {name: each.calls for name, each in one.statistics.items()} == {
        name: each.calls for name, each in other.statistics.items()
    }


@pytest.mark.parametrize("trouble", clocks.TROUBLES[1:])
def test_both_loops_stop_alike(fmu: Path, trouble: str) -> None:
    one, other = both(fmu, TIMING, WIRES, trouble=clocks.TROUBLES.index(trouble))
    assert type(one) is type(other)
    if isinstance(one, RunFailed) or isinstance(other, RunFailed):
        assert str(one) == str(other)
        assert trouble not in ("warns", "ends", "stops")
    else:
        assert bits(one.trace) == bits(other.trace)
        assert one.warnings == other.warnings and one.ended == other.ended
        assert bool(one.ended) == (trouble in ("ends", "stops"))
        assert (one.warnings["b"] > 0) == (trouble == "warns")


@pytest.mark.parametrize("trouble", ["behind", "beyond"])
def test_a_step_that_ends_early_where_it_cannot_have_come_to_is_named(fmu: Path, trouble: str) -> None:
    for failed in both(fmu, TIMING, WIRES, trouble=clocks.TROUBLES.index(trouble)):
        assert isinstance(failed, RunFailed) and "which is not within it" in str(failed)


@pytest.mark.parametrize("engine", BOTH)
@pytest.mark.parametrize("clocked", [True, False])
def test_a_step_that_is_said_to_end_early_at_its_end_is_whole(engine: Engine, clocked: bool, tmp_path: Path) -> None:
    whole = {"a.trouble": float(clocks.TROUBLES.index("whole"))}
    made = clocks.build(tmp_path, ("tick",) if clocked else ())
    with open_system({"a": made}) as system, system.simulation(replace(TIMING, engine=engine)) as simulation:
        assert bits(simulation.run(whole).trace) == bits(simulation.run().trace)


LENGTHS = st.sampled_from([0.0, 1 / 3, 0.1, 0.25, 0.02, 0.123456789012345678, 0.01 / 7, 1e-17, 0.7])


@st.composite
def systems(draw: st.DrawFn) -> tuple[list[str], dict[str, float], dict[str, Fraction]]:
    """Wires, values and own steps of three FMUs with clocks of every kind, whose clocks tick each other in rising
    order, some from two sides."""
    ends = draw(st.lists(st.sampled_from(["ab", "ac", "bc"]), unique=True, min_size=1))
    wires = []
    for target in sorted({other for _, other in ends}):
        sources = [one for one, other in ends if other == target]
        for clock in ("trigger", "second"):
            source, ticking = draw(st.sampled_from(sources)), draw(st.sampled_from(clocks.OUTPUTS))
            wires.append(f"{source}.{ticking} -> {target}.{clock}")
        one = draw(st.sampled_from(sources))
        wires += [f"{one}.{draw(st.sampled_from(['last_time', 'gauge', 'events']))} -> {target}.w"]
        wires += [f"{one}.heard -> {target}.u"] * draw(st.booleans())
    values: dict[str, float] = {}
    for part in "abc":
        values[f"{part}.divisor"] = draw(st.integers(1, 4))
        values[f"{part}.delay"] = draw(LENGTHS)
        values[f"{part}.growth"] = draw(LENGTHS) or 0.3
        values[f"{part}.period"] = draw(st.sampled_from([1 / 3, 0.1, 0.7 / 11]))
        values |= {
            f"{part}.{name}": draw(st.sampled_from([1e300, 0.625, 0.3, 0.0])) for name in ("alarm_at", "event_at")
        }
        values[f"{part}.trouble"] = draw(st.sampled_from([0] * 9 + [*range(len(clocks.TROUBLES))]))
    steps = {"c": Fraction(1, 4), "b": Fraction(1, 4) * draw(st.integers(1, 2))}
    steps["a"] = steps["b"] * draw(st.integers(1, 2))
    return wires, values, steps


@pytest.fixture(scope="module")
def all_kinds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    kinds = clocks.CLOCKS | {"tick": 'intervalVariability="constant" intervalDecimal="0.03"'}
    return clocks.build(tmp_path_factory.mktemp("clocks"), kinds, name="all")


@pytest.mark.slow
@given(system=systems())
def test_clocks_of_every_kind_tick_each_other_alike_in_both_loops(
    all_kinds: Path, system: tuple[list[str], dict[str, float], dict[str, Fraction]]
) -> None:
    wires, values, steps = system
    one, other = (outcome(all_kinds, engine, wires, values, steps) for engine in BOTH)
    assert one == other


def outcome(fmu: Path, engine: Engine, wires: list[str], values: dict[str, float], steps: dict[str, Fraction]) -> Any:
    """All that can be seen of two runs of one system, the second after a reset."""
    timing = Timing(Fraction(2), steps["c"], engine=engine)
    parts = {name: ComponentSpec(fmu, step=steps[name]) for name in "abc"}
    with open_system(parts, wires) as system, system.simulation(timing) as simulation:
        found: list[Any] = []
        for _ in range(2):
            try:
                result = simulation.run(values)
            except RunFailed as failed:
                found.append((str(failed), bits(failed.result.trace)))
            else:
                calls = {name: each.calls for name, each in result.statistics.items()}
                assert result.account.engine == engine
                found.append((result.ended, bits(result.trace), calls, dict(result.warnings)))
    return found


@pytest.mark.parametrize("count", [64, 65])
def test_what_counts_its_clocks_in_bits_has_no_more_of_them(tmp_path: Path, count: int) -> None:
    path = clocks.build(tmp_path, ("tick",))
    more = "".join(
        f'<Clock name="c{n}" valueReference="{1000 + n}" causality="input" intervalVariability="triggered"/>'
        for n in range(count - 1)
    )
    text = clocks.description({"tick": clocks.CLOCKS["tick"]}).replace("<ModelVariables>", f"<ModelVariables>{more}")
    archive.write(path, {**archive.read(path), "modelDescription.xml": text.encode()})
    with open_system({"a": path}) as system, system.simulation(TIMING) as simulation:
        reason = simulation.run().account.reason
    assert reason == ("" if count == 64 else "a has more than 64 clocks")


def test_a_clock_of_a_long_decimal_ticks_where_it_should_however_often(tmp_path: Path) -> None:
    path = clocks.build(tmp_path, ("fixed",))
    timing = Timing(Fraction(4000), Fraction(10), engine=Engine.COMPILED)
    with open_system({"a": path}) as system, system.simulation(timing) as simulation:
        trace = simulation.run({"a.period": 1 / 3}).trace
    assert trace["a.n_fixed"][-1] == 12000
    assert trace["a.last_time"][-1] == float(11999 * Fraction("0.3333333333333333"))


def test_what_is_tuned_between_steps_counts_in_both_loops(fmu: Path) -> None:
    found = []
    for engine in BOTH:
        with open_system({"a": fmu}) as system, system.simulation(replace(TIMING, engine=engine)) as simulation:
            pieces: list[Trace] = []
            run = simulation.live(Run(record=["a.events", "a.seen", "a.n_tick"]), [], pieces.append, ["a.event_at"])
            for number in range(COUNT):
                if number == 4:
                    run.change("a.event_at", run.tuned.checked("a.event_at", 0.625), "a test")
                run.step()
            run.result()
            found.append(joined(pieces))
    assert bits(found[0]) == bits(found[1])
    assert found[0]["a.seen"].tolist() == [0.0] * 7 + [0.625] * (len(found[0].time) - 7)


def test_a_clock_that_floods_a_step_is_an_error_in_both_loops(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said = []
    for engine, interval, most in ((Engine.COMPILED, "5e-8", 10_000_000), (Engine.PYTHON, "1e-3", 500)):
        monkeypatch.setattr("orchestrator.fmi.clocked_slave._MOST_IN_STEP", most)
        kinds = {"tick": f'intervalVariability="constant" intervalDecimal="{interval}"'}
        path = clocks.build(tmp_path, kinds, name=f"flood{most}")
        timing = Timing(Fraction(1), Fraction(1), engine=engine)
        with (
            open_system({"a": path}) as system,
            system.simulation(timing) as simulation,
            pytest.raises(
                RunFailed, match=f"more than {most:,} events in one step; shorten the communication step"
            ) as e,
        ):
            simulation.run()
        said.append(str(e.value))
    assert said[0].startswith("a: tick at t = 0.5 s") and said[1].startswith("a: tick at t = 0.5 s")
