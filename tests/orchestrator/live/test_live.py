"""Runs in real time: what is asked for is checked, made between steps, recorded, and what is wrong changes nothing."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.errors import FmuEnded, FmuError, InputError, ServotwinError
from orchestrator.engine import LiveRun, Result, Run, RunFailed, Simulation
from orchestrator.fmi.interface import Value
from orchestrator.live import panel as panels
from orchestrator.live.keys import split
from orchestrator.live.paced import Paced
from orchestrator.live.panel import LivePanel, nudged, sparkline
from orchestrator.live.requests import Requests
from orchestrator.live.steering import Steering
from orchestrator.live.watched_file import watched
from orchestrator.progress import Figures
from tests.support.simulation.scripted import Clock, Plant, simulation

STEP = Fraction(1, 200)


class Stubborn(Clock):
    """Has a tunable factor of at most 5, whatever it is told."""

    def tune(self, name: str, value: Value) -> Value:
        return super().tune(name, min(float(value), 5.0))


def made(component: Clock | None = None, stop: Fraction = 40 * STEP, **more: Any) -> Simulation:
    """A plant that nothing drives, and a clock whose factor is tunable."""
    clock = component or Stubborn("clock", 2.0)
    ports = {name: replace(port, variability="tunable") for name, port in clock.interface.ports.items()}
    clock.interface = replace(clock.interface, ports=ports)
    plant = Plant("plant", [[-1.0]], [[1.0]], [[1.0]])  # type: ignore[arg-type]
    return simulation([plant, clock], [], step=STEP, stop=stop, **more)


def under_way() -> LiveRun[Result]:
    return made().live(Run(), [], lambda piece: None, None)


def test_all_that_is_tunable_or_that_nothing_drives_can_be_changed() -> None:
    assert list(under_way().tuned.ports) == ["plant.u0", "clock.factor"]


def test_requests_are_made_in_the_order_they_came_and_what_is_wrong_is_none(caplog: pytest.LogCaptureFixture) -> None:
    live = under_way()
    requests = Requests(live, 1e9)
    requests.ask(" clock.factor = 3 ", "a file")
    for line, problem in [
        ("clock.factor", "has no value"),
        ("clock.factor=", "has no value"),
        ("clock.factr=1", "cannot be changed; there are plant.u0, clock.factor"),
        ("clock.factor=true", "true"),
        ("clock.factor=nan", "nan"),
        ("clock.factor=three", "three"),
    ]:
        with pytest.raises(ServotwinError, match=problem):
            requests.ask(line, "a file")
    requests.ask("clock.factor=7", "keys")
    live.step()
    requests.make()
    assert [(one.step, one.before, one.value, one.by, one.taken) for one in live.tuned.changes] == [
        (1, 2.0, 3.0, "a file", True),
        (1, 3.0, 5.0, "keys", False),
    ]
    assert "clock.factor: was set to 7.0 but is 5.0" in caplog.text


def test_many_requests_at_once_are_spread_over_steps_and_none_is_lost() -> None:
    live = under_way()
    requests = Requests(live, 0.0)
    for number in range(10):
        requests.ask(f"plant.u0={number}", "a test")
    for number in range(10):
        requests.make()
        assert live.tuned.values["plant.u0"] == number
        live.step()
    assert [change.step for change in live.tuned.changes] == list(range(10))


def settled(look: Callable[[], bool]) -> None:
    """Wait until it is so; a guard against a hang is patient."""
    until = time.monotonic() + 60
    while not look():
        assert time.monotonic() < until
        time.sleep(0.01)


def test_a_watched_file_is_taken_at_first_and_whenever_a_line_changes(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file, live = tmp_path / "values.txt", under_way()
    file.write_text("# what to try\nclock.factor = 3\n\nplant.u0=1  # V\n")
    with watched(file, Requests(live, 1e9)) as _:
        pass
    requests = Requests(live, 1e9)
    with watched(file, requests):
        file.write_text("clock.factor = 3\nplant.u0 = 2\nplant.y0 = 1\nplant.u0 = 4\n")
        settled(lambda: "value above already" in caplog.text)
        file.unlink()
        file.write_bytes(b"\xff\xfe")
        settled(lambda: "is no text in UTF-8" in caplog.text)
    requests.make()
    asked = [(change.name, change.asked) for change in live.tuned.changes]
    assert asked == [("clock.factor", 3.0), ("plant.u0", 1.0), ("plant.u0", 2.0)]
    assert f"{file}:3: plant.y0: cannot be changed" in caplog.text


@pytest.mark.parametrize(
    ("content", "problem"),
    [(None, "values.txt: cannot be read"), (b"clock.factor=x", "values.txt:1: clock.factor"), (b"\xff", "no text")],
)
def test_a_file_that_does_not_fit_at_first_is_an_error(tmp_path: Path, content: bytes | None, problem: str) -> None:
    file = tmp_path / "values.txt"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(InputError, match=problem), watched(file, Requests(under_way(), 1.0)):
        pass


@pytest.mark.slow
def test_a_paced_run_is_the_run_itself_with_its_changes_and_deadlines() -> None:
    told: list[str] = []

    def shown(live: LiveRun[Any], requests: Requests) -> None:
        requests.ask("clock.factor=4", "a test")

    def progress(fraction: float, doing: str) -> None:
        assert isinstance(doing, Figures) and set(doing.values) == {"times real time", "seconds left", "late steps"}
        told.append(doing)

    begun = time.monotonic()
    result = Paced(Steering(None, None, shown, progress)).execute(made(), Run())
    assert time.monotonic() - begun >= float(39 * STEP)
    expected = made().run({"clock.factor": 4.0})
    assert np.array_equal(result.trace["clock.y"][1:], expected.trace["clock.y"][1:])
    assert result.trace["clock.factor"].tolist() == [4.0] * 41
    assert result.trace.time.tobytes() == expected.trace.time.tobytes()
    assert result.deadlines is not None and result.deadlines.lateness.count == 40
    assert [change.by for change in result.changes] == ["a test"]
    assert len(told) == 2


@pytest.mark.slow
def test_stimuli_drive_a_paced_run_as_any_other() -> None:
    drive = np.sin(np.arange(41.0))
    stimulated = Plant("plant", [[-1.0]], [[1.0]], [[1.0]])  # type: ignore[arg-type]
    both = [simulation([stimulated], [], step=STEP, stop=40 * STEP, stimulated=["plant.u0"]) for _ in range(2)]
    run = Run({}, {"plant.u0": drive}, ["plant.u0", "plant.y0"])
    assert Paced(Steering()).execute(both[0], run).trace == both[1].execute(run).trace


@pytest.mark.slow
def test_a_failure_leaves_what_there_was_until_then() -> None:
    clock = Stubborn("clock", 2.0)
    clock.fail_at = 7
    with pytest.raises(RunFailed, match="clock: step") as failure:
        Paced(Steering()).execute(made(clock), Run())
    assert isinstance(failure.value, FmuError) and failure.value.result.account.steps == 7


@pytest.mark.slow
def test_an_fmu_that_asks_to_stop_ends_the_run_well() -> None:
    class Ending(Stubborn):
        def step(self, time: float, duration: float) -> None:
            if time >= 3 * float(STEP):
                raise FmuEnded(self.name, "asked to stop")
            super().step(time, duration)

    result = Paced(Steering()).execute(made(Ending("clock", 2.0)), Run())
    assert "asked to stop" in result.ended and len(result.trace) == 3


def test_the_keys_choose_change_and_type_values() -> None:
    live = under_way()
    panel, requests = LivePanel("a run"), Requests(live, 1e9)
    panel.press("up")  # before there is anything
    panel.begin(live, requests)
    for key in ["down", *"2.0", "\x7f", "5", "enter", "right", "up", "left", *"x", "enter"]:
        panel.press(key)
    requests.make()
    assert [(one.name, one.asked) for one in live.tuned.changes] == [
        ("clock.factor", 2.5),
        ("clock.factor", 2.02),
        ("plant.u0", -0.01),
    ]


def test_keys_that_nobody_asked_for_hide_none_that_follow() -> None:
    assert [*split("\x1b[5~ \x1b[A1\x1bOP\x1b[1;5C\x03\x1b")] == ["space", "up", "1", "ctrl-c"]


@pytest.mark.parametrize("typed", ["1 ", "1\x03", "\x1c"])
def test_space_ends_a_run_as_ctrl_c_does_whatever_is_typed(typed: str) -> None:
    panel = LivePanel("a run")
    pressing = threading.Timer(0.1, lambda: [panel.press(key) for key in split(typed)])
    pressing.start()
    with pytest.raises(KeyboardInterrupt):
        time.sleep(300)
    pressing.join()


def test_the_panel_shows_signals_values_and_why_one_was_not_taken() -> None:
    live = made().live(Run(), ["plant.y0"], lambda piece: None, None)
    panel = LivePanel("a run")
    panel.begin(live, Requests(live, 1.0))
    for _ in range(3):
        live.step()
        panel.move(0.3, "3 s, 0 late steps")
    for key in [*"oh", "enter"]:
        panel.press(key)
    console = panels.Console(width=100, record=True)
    console.print(panel.picture())
    text = console.export_text()
    for expected in ("a run  30 %  3 s, 0 late steps", "plant.y0", "▸ plant.u0", "clock.factor", "cannot be 'oh'"):
        assert expected in text


@pytest.mark.parametrize(
    ("value", "more", "less"), [(2.0, 2.02, 1.98), (-2.0, -1.98, -2.02), (0.0, 0.01, -0.01), (3, 4, 2), (True, 0, 0)]
)
def test_an_arrow_changes_a_value_by_a_percent_upwards_or_downwards(value: Value, more: Value, less: Value) -> None:
    assert (nudged(value, 0.01), nudged(value, -0.01)) == (more, less)


def test_a_sparkline_reaches_from_the_lowest_to_the_highest_value() -> None:
    assert sparkline([0.0, 3.5, 7.0, float("nan"), float("inf")]) == "▁▅█  "
    assert sparkline([2.0, 2.0]) == "▁▁" and sparkline([]) == ""


def test_what_is_tuned_is_checked_before_anything_is_stepped() -> None:
    with pytest.raises(InputError, match="did you mean"):
        Paced(Steering(("plant.u",))).execute(made(), Run())
