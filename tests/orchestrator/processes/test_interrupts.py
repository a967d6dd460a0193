"""Interrupts take effect where nothing is torn: after what must be whole, after a step of a Python FMU."""

from __future__ import annotations

import contextlib
import pickle
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from fmus.packaging import targets
from orchestrator.assembly.wiring import wire
from orchestrator.engine import Interrupted, Simulation, Timing
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.slave import Slave
from orchestrator.processes import interrupts
from orchestrator.processes.interrupts import Interrupts, requested, whole
from orchestrator.realtime.stopping import stop_requests
from orchestrator.system import Part
from orchestrator.trace import Trace
from tests.support.fmus import slow
from tests.support.simulation.scripted import Clock, simulation

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX signals")


def interrupt(number: int = signal.SIGINT) -> None:
    signal.raise_signal(number)


@pytest.fixture
def later(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Lets enough time pass that a signal is another wish."""
    passed: list[float] = []
    monkeypatch.setattr(interrupts, "monotonic", lambda: sum(passed))
    return lambda: passed.append(interrupts.SAME)


@pytest.fixture(autouse=True)
def same_handler() -> Iterator[None]:
    """Whatever a test does, the handler afterwards is the one before."""
    before = signal.getsignal(signal.SIGINT)
    yield
    assert signal.getsignal(signal.SIGINT) is before
    assert sys.gettrace() is None


def test_what_must_be_whole_is_finished_before_the_interrupt_takes_effect() -> None:
    done = []
    with pytest.raises(KeyboardInterrupt), whole():
        interrupt()
        done.append("rest")
    assert done == ["rest"]


def test_without_an_interrupt_only_the_handler_is_another_one_within() -> None:
    before = signal.getsignal(signal.SIGINT)
    with whole():
        assert signal.getsignal(signal.SIGINT) is not before
    assert signal.getsignal(signal.SIGINT) is before


def test_a_second_interrupt_does_not_wait(later: Callable[[], None]) -> None:
    with pytest.raises(KeyboardInterrupt), whole():
        interrupt()
        later()
        interrupt()
        pytest.fail("the second one waited")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_signals_that_come_together_are_one_wish_whichever_comes_first(number: signal.Signals) -> None:
    done = []
    with Interrupts() as active:
        with pytest.raises(KeyboardInterrupt), whole():
            for each in (number, signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                interrupt(each)
            done.append("rest")
        interrupt(number)
        done.append("cleaned up")
    assert done == ["rest", "cleaned up"] and active.requested


def test_what_runs_until_it_is_told_does_not_begin_when_a_library_has_swallowed_the_interrupt() -> None:
    with Interrupts():
        with contextlib.suppress(KeyboardInterrupt):
            interrupt(signal.SIGTERM)
        with pytest.raises(KeyboardInterrupt), stop_requests():
            pytest.fail("began")


def test_an_interrupt_that_comes_where_nothing_can_be_raised_is_raised_soon_after() -> None:
    class Dying:
        def __del__(self) -> None:
            interrupt()

    with Interrupts(), pytest.raises(KeyboardInterrupt):
        dying: list[Dying] = [Dying()]
        dying.clear()
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            time.sleep(0.01)


def test_wholes_within_each_other_end_together() -> None:
    done = []
    with pytest.raises(KeyboardInterrupt), whole():
        with whole():
            interrupt()
            done.append("inner")
        done.append("outer")
    assert done == ["inner", "outer"]


def test_an_error_within_is_not_hidden_where_nobody_interrupts() -> None:
    with pytest.raises(ZeroDivisionError), whole():
        raise ZeroDivisionError


def test_an_interrupt_that_waited_comes_before_the_error_that_ended_the_wait() -> None:
    with pytest.raises(KeyboardInterrupt) as stopped, whole():
        interrupt()
        raise ZeroDivisionError
    assert isinstance(stopped.value.__context__, ZeroDivisionError)


def test_in_another_thread_whole_leaves_the_handler_alone() -> None:
    seen = []

    def work() -> None:
        before = signal.getsignal(signal.SIGINT)
        with whole():
            seen.append(signal.getsignal(signal.SIGINT) is before)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [True]


def test_it_is_known_that_an_interrupt_was_requested_until_the_command_is_over() -> None:
    assert not requested()
    with Interrupts():
        with pytest.raises(KeyboardInterrupt):
            interrupt()
        assert requested()
    assert not requested()


def test_a_last_resort_that_comes_too_late_does_not_interrupt_again(later: Callable[[], None]) -> None:
    """The FMU came back while the timer's signal was on its way: what follows is the cleaning up."""
    with Interrupts() as active:
        with pytest.raises(KeyboardInterrupt):
            interrupt()
        active._give_up()
        later()
        with pytest.raises(KeyboardInterrupt):  # a second one of the user's does
            interrupt()


@pytest.mark.parametrize("at", [0, 3, 7])
def test_a_sink_that_is_interrupted_gets_every_row_once(at: int) -> None:
    pieces: list[Trace] = []

    def sink(piece: Trace) -> None:
        if len(pieces) == at:
            interrupt()
        pieces.append(piece)

    made = simulation([Clock("clock")], step=Fraction(1, 1000), stop=Fraction(100))
    with pytest.raises(Interrupted) as stopped:
        made.run(sink=sink)
    stamps = np.concatenate([piece.time for piece in pieces])
    assert np.array_equal(stamps, np.arange(len(stamps)) / 1000)
    reached = stopped.value.result.account.reached
    assert len(stamps) == round(1000 * reached) and len(pieces) in (at + 1, at + 2)


def test_between_processes_an_interrupted_run_is_a_plain_interrupt() -> None:
    def stop(fraction: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(Interrupted) as stopped:
        simulation([Clock("clock")]).run(progress=stop)
    received = pickle.loads(pickle.dumps(stopped.value))
    assert type(received) is KeyboardInterrupt and str(received) == "interrupted at t = 1 s"


def test_a_run_of_a_python_fmu_keeps_all_up_to_its_interrupt(tmp_path: Path) -> None:
    slow.write(tmp_path, 0.005)
    path = targets.build(tmp_path / "slow.py", tmp_path / "slow.fmu", target="python")
    timing = Timing(Fraction(1000), Fraction(1, 10))
    with (
        FmuFile(path) as file,
        Simulation(wire({"slow": Part(file.interface)}, []), {"slow": Slave(file, "slow")}, timing) as made,
        Interrupts(),
    ):
        timer = threading.Timer(0.5, interrupt)
        timer.start()
        with pytest.raises(Interrupted) as stopped:
            made.run()
        timer.join()
    trace, account = stopped.value.result.trace, stopped.value.result.account
    assert 1 <= account.steps == len(trace) == round(10 * account.reached) < 10_000
    assert trace["slow.y"] == pytest.approx(np.arange(len(trace)) / 10, abs=1e-9)
