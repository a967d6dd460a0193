"""Clocks that tick at one interval do so in the compiled loop as in Python's, to the last bit and at every trouble."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from fmus.errors import WiringError
from orchestrator import open_system
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
    given = {f"b.{name}": value for name, value in values.items()}
    for engine in BOTH:
        with open_system(dict.fromkeys("abc", fmu), wires, ["a.u", "a.v"]) as system:
            driven = {"a.u": np.arange(float(COUNT)), "a.v": np.sin(np.arange(float(COUNT)))}
            with system.simulation(replace(timing, engine=engine)) as simulation:
                count = len(simulation.instants())
                cut = {name: np.resize(samples, count) for name, samples in driven.items()}
                try:
                    simulation.run(given, cut)
                    found.append(simulation.run(given, cut))  # after a reset
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


@pytest.mark.parametrize(
    ("kinds", "wires", "reason"),
    [
        (("tick", "changing"), [], "a has clocks whose intervals change"),
        (("tick", "out", "trigger"), ["a.out -> b.trigger"], "a ticks the clocks of others"),
    ],
)
def test_other_clocks_are_pythons(tmp_path: Path, kinds: tuple[str, ...], wires: list[str], reason: str) -> None:
    path = clocks.build(tmp_path, kinds)
    with open_system(dict.fromkeys("ab", path), wires) as system:
        with system.simulation(TIMING) as simulation:
            assert simulation.run().account.reason == reason
        with (
            system.simulation(replace(TIMING, engine=Engine.COMPILED)) as simulation,
            pytest.raises(WiringError, match=f"engine: cannot be the compiled one: {reason}"),
        ):
            simulation.run()


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
