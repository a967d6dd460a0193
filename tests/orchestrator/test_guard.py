"""However a command's process ends, its exit code and its last line are true, and it leaves nothing behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from orchestrator import guard
from orchestrator.processes.last_words import LastWords

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs fork")
ROOT = Path(__file__).parents[2]
COMMAND = """
import ctypes, os, signal, sys, tempfile, time
from pathlib import Path
from orchestrator import guard
from orchestrator.processes import last_words
from orchestrator.guard import guarded
guard.PATIENCE = 2
libc = ctypes.CDLL(None)
def work():
    Path(tempfile.mkdtemp(), "left").touch()
    last_words.own().say(last_words.FMU, "wheel (bad.fmu)")
    print("said", flush=True)
    {work}
guarded(work)
"""


def started(tmp_path: Path, work: str) -> subprocess.Popen[str]:
    (tmp_path / "scratch").mkdir()
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND.format(work=work)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=os.environ | {"PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path / "scratch")},
    )


def ended(running: subprocess.Popen[str], tmp_path: Path) -> tuple[int, str]:
    """Exit code and standard error of one that leaves nothing."""
    _, said = running.communicate(timeout=60)
    assert list((tmp_path / "scratch").iterdir()) == []
    return running.returncode, said


@pytest.mark.parametrize(("work", "code"), [("", 0), ("sys.exit()", 0), ("sys.exit(1)", 1), ("sys.exit(130)", 130)])
def test_an_end_of_ones_own_has_its_code_and_nothing_is_added(tmp_path: Path, work: str, code: int) -> None:
    assert ended(started(tmp_path, work), tmp_path) == (code, "")


@pytest.mark.parametrize(
    ("work", "how"),
    [
        ("libc.exit(0)", "ended the command's process, or closed its output (exit code 0)"),
        ("os._exit(1)", "ended the command's process, or closed its output (exit code 1)"),
        ("[os.close(number) for number in range(64) if number != 8]", "closed its output"),
        ("os.dup2(os.open(os.devnull, os.O_WRONLY), 1)", "closed its output"),
        ("libc.abort()", "crashed the command's process (SIGABRT)"),
        ("ctypes.string_at(0)", "crashed the command's process (SIGSEGV)"),
    ],
)
def test_an_end_by_an_fmu_is_never_green_and_names_it(tmp_path: Path, work: str, how: str) -> None:
    code, said = ended(started(tmp_path, work), tmp_path)
    assert code == 3 and "Traceback" not in said
    assert said.startswith("servotwin: wheel (bad.fmu): the FMU ") and how in said and "--isolate" in said
    assert len(said.splitlines()) == 1


@pytest.mark.parametrize(
    ("work", "line"),
    [
        ("", "the command's process was killed (SIGKILL): by somebody, or as memory was short"),
        (
            "last_words.own().say(last_words.KILLED, 'no step has ended for 4 s')",
            "wheel (bad.fmu): the FMU hangs, and its process was killed: no step has ended for 4 s;"
            " run with --isolate to learn where",
        ),
    ],
)
def test_a_kill_is_no_crash_and_one_of_ours_says_why(tmp_path: Path, work: str, line: str) -> None:
    killed = f"{work or 'pass'}; os.kill(os.getpid(), signal.SIGKILL)"
    assert ended(started(tmp_path, killed), tmp_path) == (3, f"servotwin: {line}\n")


@pytest.mark.slow
def test_who_saves_a_result_is_waited_for(tmp_path: Path) -> None:
    work = (
        "guard._LEAVING = 0.1; last_words.own().say(last_words.SAVING, 'it');"
        f"os.fork() and os.kill(os.getpid(), signal.SIGKILL); time.sleep(1); Path('{tmp_path}', 'saved').touch();"
        "os._exit(0)"
    )
    ended(started(tmp_path, work), tmp_path)
    assert (tmp_path / "saved").exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("group", [False, True])
def test_a_wish_to_end_reaches_the_command_once(tmp_path: Path, number: signal.Signals, group: bool) -> None:
    work = "\n    ".join(
        [
            "try: print('ready', flush=True); time.sleep(60)",
            "except KeyboardInterrupt: time.sleep(0.3); sys.exit(130)",
        ]
    )
    running = started(tmp_path, work)
    assert running.stdout is not None and [running.stdout.readline() for _ in range(2)] == ["said\n", "ready\n"]
    (os.killpg if group else os.kill)(running.pid, number)
    assert ended(running, tmp_path) == (130, "")


def test_a_crash_after_a_wish_to_end_is_told(tmp_path: Path) -> None:
    work = "\n    ".join(
        ["try: print('ready', flush=True); time.sleep(60)", "except KeyboardInterrupt: ctypes.string_at(0)"]
    )
    running = started(tmp_path, work)
    assert running.stdout is not None and [running.stdout.readline() for _ in range(2)] == ["said\n", "ready\n"]
    running.send_signal(signal.SIGINT)
    assert ended(running, tmp_path) == (
        130,
        "interrupted; wheel (bad.fmu) crashed the command's process (SIGSEGV)\n",
    )


@pytest.mark.slow
def test_what_ignores_a_wish_to_end_is_killed(tmp_path: Path) -> None:
    work = "libc.signal(2, ctypes.c_void_p(1))\n    print('ready', flush=True)\n    libc.sleep(600)"
    running = started(tmp_path, work)
    assert running.stdout is not None and [running.stdout.readline() for _ in range(2)] == ["said\n", "ready\n"]
    running.send_signal(signal.SIGINT)
    assert ended(running, tmp_path) == (130, "interrupted; wheel (bad.fmu) did not let go\n")


@pytest.mark.slow
def test_a_command_that_asks_for_its_own_end_and_hangs_is_killed(tmp_path: Path) -> None:
    work = "import threading; from orchestrator.processes import interrupts; libc.signal(2, ctypes.c_void_p(1))"
    work += "\n    threading.Timer(0.1, interrupts.ask).start(); libc.sleep(600)"
    assert ended(started(tmp_path, work), tmp_path) == (130, "interrupted; wheel (bad.fmu) did not let go\n")


def test_the_command_ends_with_its_parent_and_cleans_up(tmp_path: Path) -> None:
    running = started(tmp_path, "time.sleep(600)")
    assert running.stdout is not None and running.stdout.readline() == "said\n"
    running.kill()
    _, said = running.communicate(timeout=60)  # until who holds the pipes has ended
    assert said == "servotwin: the process that watches over the command is gone; the command ends\n"
    assert list((tmp_path / "scratch").iterdir()) == []


@pytest.mark.slow
def test_a_command_that_hangs_ends_with_its_parent(tmp_path: Path) -> None:
    running = started(tmp_path, "libc.signal(15, ctypes.c_void_p(1)); print('ready', flush=True); libc.sleep(600)")
    assert running.stdout is not None and [running.stdout.readline() for _ in range(2)] == ["said\n", "ready\n"]
    running.kill()
    _, said = running.communicate(timeout=60)
    assert said.splitlines()[1:] == ["servotwin: wheel (bad.fmu) did not let go; its process is killed"]


def test_what_was_killed_as_a_whole_is_removed_by_the_next_and_what_lives_is_not(tmp_path: Path) -> None:
    first = started(tmp_path, "print(os.getpid(), flush=True); time.sleep(600)")
    assert first.stdout is not None and first.stdout.readline() == "said\n"
    child = int(first.stdout.readline())
    [left] = (tmp_path / "scratch").iterdir()
    another = [sys.executable, "-c", COMMAND.format(work="")]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path / "scratch")}
    subprocess.run(another, env=environment, check=True, stdout=subprocess.DEVNULL)
    assert list((tmp_path / "scratch").iterdir()) == [left]
    os.kill(child, signal.SIGSTOP)  # so that it does not clean up for its parent
    first.kill()
    os.kill(child, signal.SIGKILL)
    first.communicate(timeout=60)
    subprocess.run(another, env=environment, check=True, stdout=subprocess.DEVNULL)
    assert list((tmp_path / "scratch").iterdir()) == []


@pytest.mark.skipif(sys.platform != "linux", reason="only there is it seen who has ended")
def test_processes_whose_end_nobody_notes_are_not_waited_for(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", ""], start_new_session=True) as left:
        os.waitid(os.P_PID, left.pid, os.WEXITED | os.WNOWAIT)
        os.killpg(left.pid, 0)  # it is still in the table
        slept: list[float] = []
        monkeypatch.setattr(guard, "sleep", slept.append)
        guard._end_group(left.pid, LastWords(tmp_path / "words"))
    assert slept == []
