"""Processes that work side by side: their answers, their deaths, and that they end with the one that began them."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

from orchestrator.processes import last_words
from orchestrator.processes.child import Died
from orchestrator.processes.pool import Processes, at_most, calling, processors

Task = Callable[[], object]
PARENT = """
import time
from functools import partial
from orchestrator.processes.pool import Processes, calling
from tests.orchestrator.processes.test_pool import note_and_hang, note_and_sleep

if __name__ == "__main__":
    with Processes(calling, 2) as pool:
        list(pool.answers([partial({work}, {folder!r}, number) for number in range(2)]))
"""


def note_and_sleep(folder: str, number: int) -> None:
    """Say in a file who works, and where its temporary files are; then work for long."""
    Path(folder, f"{number}.part").write_text(f"{os.getpid()} {tempfile.gettempdir()}")
    Path(folder, f"{number}.part").rename(Path(folder, str(number)))
    time.sleep(60)


def note_and_hang(folder: str, number: int) -> None:
    """The same, but nothing that Python code could handle ends it."""
    with contextlib.suppress(KeyboardInterrupt):
        note_and_sleep(folder, number)
    note_and_hang(folder, number)


def spent(answer: object) -> bool:
    """Whatever it was."""
    return True


def alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def wait_until(holds: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 60
    while not holds() and time.monotonic() < deadline:
        time.sleep(0.02)
    assert holds()


@pytest.mark.parametrize("fresh", [False, True])
def test_each_task_has_its_answer_whoever_gives_it(fresh: bool) -> None:
    with Processes[Task, object](calling, 2, spent=spent if fresh else None) as pool:
        answers = dict(pool.answers([partial(divmod, number, 3) for number in range(7)]))
    assert answers == {number: divmod(number, 3) for number in range(7)}


def test_a_fresh_process_takes_one_task_and_another_takes_all() -> None:
    with Processes[Task, object](calling, 1, spent=spent) as pool:
        fresh = [pid for _, pid in pool.answers([os.getpid] * 3)]
    with Processes[Task, object](calling, 1) as pool:
        kept = [pid for _, pid in pool.answers([os.getpid] * 3)]
    assert len(set(fresh)) == 3 and len(set(kept)) == 1


@pytest.mark.parametrize("fresh", [False, True])
def test_a_death_costs_one_task_and_is_named(fresh: bool) -> None:
    tasks: list[Task] = [os.getpid, partial(signal.raise_signal, signal.SIGKILL), os.getpid, os.getpid]
    with Processes[Task, object](calling, 1, spent=spent if fresh else None) as pool:
        answers = dict(pool.answers(tasks))
    died = answers.pop(1)
    assert isinstance(died, Died) and died.ending == "died (SIGKILL)"
    assert all(isinstance(pid, int) for pid in answers.values())


def test_patience_ends_with_the_task_that_is_silent_and_the_next_one_is_answered() -> None:
    with Processes[Task, object](calling, 1, patience=0.5) as pool:
        answers = dict(pool.answers([partial(time.sleep, 60), os.getpid]))
    silent = answers[0]
    assert isinstance(silent, Died) and silent.ending.startswith("gave no answer for 0.5")
    assert isinstance(answers[1], int)


def test_where_it_waits_for_ever_a_long_silence_is_told_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("orchestrator.processes.pool._LONG", 0.05)
    with Processes[Task, object](calling, 1, silence="still waiting") as pool:
        assert len(list(pool.answers([partial(time.sleep, 0.4), partial(time.sleep, 0.4)]))) == 2
    assert [record.message for record in caplog.records] == ["still waiting"]


def test_tasks_are_taken_when_there_is_a_process_for_them() -> None:
    taken: list[int] = []

    def tasks() -> Iterator[Task]:
        for number in range(6):
            taken.append(number)
            yield partial(abs, number)

    with Processes[Task, object](calling, 2) as pool:
        for done, _ in enumerate(pool.answers(tasks()), start=1):
            assert len(taken) <= done + 2


def say_and_exit() -> None:
    last_words.own().say(last_words.FMU, "wheel (bad.fmu)")
    os._exit(0)


def test_an_end_with_exit_code_0_is_a_death_that_names_the_fmus() -> None:
    with Processes[Task, object](calling, 1) as pool:
        [(_, died)] = pool.answers([say_and_exit])
    assert isinstance(died, Died) and (died.ending, died.fmus) == ("died (exit code 0)", "wheel (bad.fmu)")


UNGUARDED = """
from orchestrator.processes.pool import Processes

def make():
    return abs

with Processes(make, 1) as pool:
    list(pool.answers([-1]))
"""


@pytest.mark.slow
@pytest.mark.parametrize("as_file", [True, False])
def test_a_script_without_a_guard_is_told_what_its_processes_need(tmp_path: Path, as_file: bool) -> None:
    (tmp_path / "script.py").write_text(UNGUARDED)
    command = [sys.executable, str(tmp_path / "script.py") if as_file else "-"]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    done = subprocess.run(command, env=environment, input=UNGUARDED, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("fmus.errors.InputError: ") and "__name__ ==" in done.stderr
    assert "multiprocessing" not in done.stderr


AHEAD = """
import sys
from functools import partial
from orchestrator.processes.child import load_ahead
from orchestrator.processes.pool import Processes, calling

print("once")
load_ahead(["colorsys"])
with Processes(calling, 1) as pool:
    print(*pool.answers([partial(eval, "'colorsys' in __import__('sys').modules")]), "colorsys" in sys.modules)
"""


@pytest.mark.slow
def test_what_is_loaded_ahead_is_there_in_processes_and_a_script_without_a_guard_runs_once(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(AHEAD)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    command = [sys.executable, str(tmp_path / "script.py")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("once\n(0, True) False\n", "")


def test_a_process_sees_the_environment_of_now(monkeypatch: pytest.MonkeyPatch) -> None:
    for value in ("one", "two"):
        monkeypatch.setenv("SERVOTWIN_TEST", value)
        with Processes[Task, object](calling, 1) as pool:
            assert dict(pool.answers([partial(os.getenv, "SERVOTWIN_TEST")])) == {0: value}


def test_temporary_files_go_with_the_pool() -> None:
    with Processes[Task, object](calling, 1) as pool:
        folder = Path(str(dict(pool.answers([tempfile.mkdtemp]))[0]))
        assert folder.is_dir()
    assert not folder.exists() and not folder.parent.exists()


@pytest.mark.slow
@pytest.mark.parametrize("work", ["note_and_sleep", "note_and_hang"])
def test_processes_and_their_files_go_when_the_main_process_is_killed(tmp_path: Path, work: str) -> None:
    script = tmp_path / "parent.py"
    script.write_text(PARENT.format(folder=str(tmp_path), work=work))
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    with subprocess.Popen([sys.executable, str(script)], env=environment) as parent:
        wait_until(lambda: all((tmp_path / number).exists() for number in "01"))
        parent.kill()
    said = [(tmp_path / number).read_text().split() for number in "01"]
    wait_until(lambda: not any(alive(int(pid)) for pid, _ in said))
    assert not any(Path(folder).exists() for _, folder in said)


def test_as_many_processes_are_used_as_are_allowed_while_they_are() -> None:
    usual = processors()
    with at_most(7):
        assert processors() == 7
        with at_most(None):
            assert processors() == 7
        with at_most(1):
            assert processors() == 1
    assert processors() == usual == (os.cpu_count() or 1)
