"""A command in a process of its own, and a parent that tells the truth about its end.

An FMU runs in the command's process and may end it (`exit(0)`), crash it, close its descriptors or hang: the parent
turns an end that the command itself did not come to into an exit code and a line, and removes what was left.
"""

from __future__ import annotations

import os
import select
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from time import monotonic, sleep
from typing import NoReturn

from fmus import owned
from fmus.errors import ServotwinError
from orchestrator.display.stdout import all_there
from orchestrator.processes import interrupts, last_words
from orchestrator.processes.last_words import KILLED, LITTER, SAVING, LastWords, culprits
from orchestrator.results import put_back, rescue

PATIENCE = 10  # with a command that was told to end and has not heard it [s]
_AGAIN = 0.5  # until it is told again [s]
_LEAVING = 3.0  # patience with processes that the command has left [s]
_SAVING = 120.0  # ... while they save its result
_FAULTS = {signal.SIGSEGV, signal.SIGABRT, signal.SIGFPE, signal.SIGILL, getattr(signal, "SIGBUS", None)}
_NAME = "servotwin"  # of the folder for temporary files


def guarded(work: Callable[[], None]) -> None:
    """Do the work in a child of this process, which ends with the child's exit code: the caller goes on there alone.

    Without effect where there is no `fork`, or threads that a child would lack.
    """
    all_there()
    if sys.platform == "win32" or threading.active_count() > 1:
        work()
        return
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    watched = {signal.SIGCHLD, signal.SIGALRM, signal.SIGTSTP, *interrupts.endings()}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, watched)
    words = last_words.begin(LastWords())
    usual = _own_temporary_folder(words)
    life, held = os.pipe()
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child:
        os.close(life)
        owned.sweep(usual, _NAME)
        _watch(child, watched, words)
    os.close(held)
    interrupts.guarded_by(os.getppid())
    with interrupts.Interrupts():
        try:
            _stand_alone()
            threading.Thread(target=_outlive, args=(life, words), name="end of the guard", daemon=True).start()
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
            _work(work, words)
        except KeyboardInterrupt:
            interrupts.ignore()
            sys.exit(130)  # the parent says why
        finally:
            if select.select([life], [], [], 0)[0]:  # the parent is gone
                _remove(words)


def _own_temporary_folder(words: LastWords) -> Path:
    """The usual folder, in which all temporary files of the command are from now on in a folder of its own."""
    usual = Path(os.environ.get("TMPDIR") or "/tmp")
    with suppress(OSError):  # then they go where they can
        folder, _ = owned.create(usual, _NAME)
        words.say(LITTER, str(folder))
        os.environ["TMPDIR"] = str(folder)
    return usual


def _stand_alone() -> None:
    """Be in a process group of one's own: a terminal's signals reach the parent, which passes them on once."""
    if sys.platform == "win32":
        raise OSError("Windows does not fork")
    os.setpgid(0, 0)
    signal.signal(signal.SIGTTOU, signal.SIG_IGN)  # to write to the terminal is no reason to be stopped
    if os.isatty(0):  # to read from it would be
        with Path(os.devnull).open() as nothing:
            os.dup2(nothing.fileno(), 0)


def _outlive(life: int, words: LastWords) -> None:
    """Await the end of the parent, who has the other end of `life`, and end as it would have had it: none of this waits
    for an FMU."""
    if sys.platform == "win32":
        raise OSError("Windows does not fork")
    try:
        os.read(life, 1)
    except OSError:  # an FMU has closed it
        return
    _say("the process that watches over the command is gone; the command ends")
    begun = monotonic()
    while monotonic() < begun + (_SAVING if words.heard else PATIENCE):
        if not words.heard:
            os.kill(os.getpid(), signal.SIGTERM)
        sleep(_AGAIN)
    _say(f"{culprits(words) or 'the command'} did not let go; its process is killed")
    os.kill(os.getpid(), signal.SIGKILL)  # what it leaves behind the next command removes


def _say(line: str) -> None:
    with suppress(OSError):
        os.write(2, f"servotwin: {line}\n".encode(errors="replace"))


def _work(work: Callable[[], None], words: LastWords) -> None:
    """Do the work; all is done when it ends, or exits by itself, and what it said could be said."""
    streams = _streams()
    code = 0
    try:
        work()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        raise
    finally:
        interrupts.ignore()
        with suppress(OSError, ValueError):
            sys.stdout.flush()
            sys.stderr.flush()
        if isinstance(sys.exception(), SystemExit | None) and _streams() == streams:
            words.end(code)


def _streams() -> list[tuple[int, int] | None]:
    """What standard output and error are: an FMU may have closed them, or put files in their place."""
    return [_identity(number) for number in (1, 2)]


def _identity(descriptor: int) -> tuple[int, int] | None:
    try:
        status = os.fstat(descriptor)
    except OSError:
        return None
    return status.st_dev, status.st_ino


def _watch(child: int, watched: set[signal.Signals], words: LastWords) -> NoReturn:
    """Pass signals on to the child, await its end, clean up, and leave with the exit code."""
    if sys.platform == "win32":
        raise OSError("Windows does not fork")
    with suppress(OSError):  # the child does it as well; whoever comes first
        os.setpgid(child, child)
    sent: list[int] = []
    given_up, told = False, 0.0
    while True:
        number = signal.sigwait(watched)
        if number == signal.SIGCHLD:
            done, status = os.waitpid(child, os.WNOHANG)
            if done:
                break
        elif number == signal.SIGTSTP:
            os.killpg(child, signal.SIGTSTP)
            os.kill(os.getpid(), signal.SIGSTOP)
            os.killpg(child, signal.SIGCONT)
        elif number != signal.SIGALRM:
            sent.append(number)
            told = monotonic()
            os.kill(child, number)
            signal.setitimer(signal.ITIMER_REAL, _AGAIN, _AGAIN)
        elif words.heard:
            signal.setitimer(signal.ITIMER_REAL, 0)
        elif monotonic() < told + PATIENCE:
            os.kill(child, sent[-1])  # one that comes just before a call that waits is heard only after that
        else:
            given_up = True
            os.kill(child, signal.SIGKILL)  # alone: whoever has a bus for it sends the safe values
    _end_group(child, words)
    code = words.code
    if code is None:
        line, code = _verdict(os.waitstatus_to_exitcode(status), words, bool(sent), given_up)
        with suppress(OSError):
            os.write(2, f"{_rescued(words)}{line}\n".encode(errors="replace"))
    _remove(words)
    os._exit(code)


def _end_group(group: int, words: LastWords) -> None:
    """See that no process of the command is left: most end by themselves when it has."""
    if sys.platform == "win32":
        raise OSError("Windows does not fork")
    begun = monotonic()
    with suppress(OSError):  # there is none
        while monotonic() < begun + (_SAVING if words.said(SAVING) else _LEAVING):
            os.killpg(group, 0)
            if _over(group):
                return
            sleep(0.01)
        os.killpg(group, signal.SIGKILL)


def _over(group: int) -> bool:
    """Whether all processes of a group have ended: the first process of a container may never take note of it, and they
    stay in the system's table."""
    states = []
    for file in Path("/proc").glob("[0-9]*/stat"):  # there are none but on Linux
        with suppress(OSError):  # one that is gone by now
            state, _, own = file.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()[:3]
            states += [state] if own == str(group) else []
    return bool(states) and set(states) <= {"Z", "X"}


def _rescued(words: LastWords) -> str:
    """Save what the command has recorded and could not; a line about it."""
    said = []
    for place in map(Path, words.said(LITTER)):
        try:
            said.append(rescue(place))
        except (OSError, ServotwinError) as error:
            said.append(f"its record is lost ({error})")
    return "".join(f"servotwin: {line}\n" for line in said if line)


def _remove(words: LastWords) -> None:
    for place in map(Path, words.said(LITTER)):
        with suppress(OSError):
            put_back(place)
        shutil.rmtree(place, ignore_errors=True)


def _verdict(code: int, words: LastWords, interrupted: bool, given_up: bool) -> tuple[str, int]:
    """The line and the exit code for an end that the command did not come to."""
    if sys.platform == "win32":
        raise OSError("Windows does not fork")
    names = culprits(words)
    if interrupted and (given_up or words.said(KILLED)):
        return f"interrupted; {names or 'the command'} did not let go", 130
    if interrupted and -code not in _FAULTS:
        return "interrupted", 130
    if code == -signal.SIGKILL:
        return _killed(names, words.said(KILLED)), 3
    if code >= 0:
        how = f"ended the command's process, or closed its output (exit code {code})"
    else:
        known = {number.value: number.name for number in signal.Signals}
        how = f"crashed the command's process ({known.get(-code, f'signal {-code}')})"
    if interrupted:
        return f"interrupted; {names or 'something'} {how}", 130
    if not names:
        return f"servotwin: something {how}; run with -vv and report what that says", 4
    return f"servotwin: {names}: the FMU {how}; run with --isolate to learn when, or ask for a repaired one", 3


def _killed(names: str, why: Sequence[str]) -> str:
    """The line for an end that no program can come to by itself."""
    if not why:
        return "servotwin: the command's process was killed (SIGKILL): by somebody, or as memory was short"
    fmu = f"{names}: the FMU" if names else "the command"
    return f"servotwin: {fmu} hangs, and its process was killed: {', '.join(why)}; run with --isolate to learn where"
