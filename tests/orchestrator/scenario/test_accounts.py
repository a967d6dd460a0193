"""What stepping took: who did it, how far, and whose time it was; every second is somebody's."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.engine import Account, Engine, Interrupted, shares
from orchestrator.engine.loop import Statistics
from tests.support.simulation.scripted import Clock, Gain, simulation

SECONDS = st.floats(0, 1e6)
STATISTICS = st.dictionaries(st.sampled_from("abc"), st.builds(Statistics, st.integers(0, 10**9), SECONDS))


def account(seconds: float, steps: int = 10) -> Account:
    return Account(Engine.COMPILED, "", steps, 0.1, 2.0, 3.0, seconds)


@given(st.lists(st.tuples(SECONDS.map(account), STATISTICS), max_size=4))
def test_shares_are_of_all_the_time_and_sum_to_it(runs: list[tuple[Account, dict[str, Statistics]]]) -> None:
    *components, loop = shares(runs)
    inside = sum(each.seconds for _, statistics in runs for each in statistics.values())
    wall = sum(each.seconds for each, _ in runs)
    assert loop.name is None and loop.calls == 10 * len(runs)
    assert loop.seconds == pytest.approx(max(wall - inside, 0), rel=1e-9, abs=1e-9 * wall)
    assert sum(each.seconds for each in components) == pytest.approx(inside)
    assert {each.name for each in components} == {name for _, statistics in runs for name in statistics}
    if max(wall, inside) > 1e-3:
        assert sum(each.percent for each in [*components, loop]) == pytest.approx(100)


def test_calls_and_times_of_several_runs_add_up() -> None:
    runs = [(account(1.0), {"a": Statistics(10, 0.25)}), (account(3.0), {"a": Statistics(30, 0.75)})]
    one, loop = shares(runs)
    assert (one.name, one.calls, one.seconds, one.percent) == ("a", 40, 1.0, 25.0)
    assert (loop.calls, loop.seconds, loop.percent) == (20, 3.0, 75.0)
    assert one.microseconds == pytest.approx(1e6 / 40)


def test_the_real_time_factor_counts_from_the_start() -> None:
    assert account(0.5).real_time_factor == 2.0


def test_a_run_accounts_for_its_steps_whatever_the_components_own_are() -> None:
    made = simulation(
        [Clock("clock"), Gain("gain", 2.0)],
        ["clock.y -> gain.u0"],
        start=Fraction(2),
        stop=Fraction(4),
        steps={"clock": Fraction(1, 40)},
    )
    found = made.run().account
    assert (found.steps, found.step, found.start, found.reached) == (20, 0.1, 2.0, 4.0)
    assert found.engine is Engine.PYTHON and found.reason == "clock is no co-simulation FMU in this process"
    assert 0 < found.seconds < 10
    assert made.run(stop=Fraction(3)).account.reached == 3.0


def test_an_interrupted_run_accounts_for_what_was_done() -> None:
    def stop(fraction: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(Interrupted) as stopped:
        simulation([Clock("clock")], step=Fraction(1, 1000), stop=Fraction(9)).run(progress=stop)
    result = stopped.value.result
    assert (result.account.steps, result.account.reached) == (2000, 2.0)
    assert result.statistics["clock"].calls == 2000 and len(result.trace) == 2000
