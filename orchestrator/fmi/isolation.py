"""A component in a process of its own: when its FMU crashes or hangs, that component fails and nothing else does.

The worker process loads the FMU and does what it is told over two pipes; a step, with its inputs and outputs, is one
message there and one back. What a worker says is read as numbers and JSON, for its memory may be spoilt.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import pickle
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Any

from fmus import errors
from fmus.errors import FmuError, InputError, ServotwinError
from orchestrator.fmi import isolation_worker as messages
from orchestrator.fmi.clocks.ticks import Arrival, Tick
from orchestrator.fmi.component import Texts
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.interface import Value
from orchestrator.fmi.isolation_worker import Make, MessagePipe
from orchestrator.fmi.said import REPEATS

LOG = logging.getLogger("servotwin.isolation")
PATIENCE = 60.0  # with an FMU that owes an answer [s]
LONGEST = 1e6  # patience that can be asked for [s]
_STARTING = 120.0  # patience with a process that has still to load Python's libraries [s]
_DYING = 5.0  # patience with a process that has closed its pipe [s]
_ERRORS: dict[str, type[ServotwinError]] = {
    name: kind for name, kind in vars(errors).items() if isinstance(kind, type) and issubclass(kind, ServotwinError)
}
_BOOT = "import sys; sys.path[:] = {path!r}; from orchestrator.fmi.isolation_worker import serve; serve({life})"
_CLEAR = 'read finished || rm -rf -- "$0"'


@dataclass(frozen=True)
class Isolation:
    """How FMUs are isolated.

    Attributes:
        patience: the longest an answer may take before the FMU counts as hanging [s].

    Raises:
        InputError: no time to wait, or none that ends.
    """

    patience: float = PATIENCE

    def __post_init__(self) -> None:
        if sys.platform == "win32":
            raise InputError("--isolate", "needs what Windows does not have", "leave it out, or work under WSL")
        if not 0 < self.patience <= LONGEST:
            raise InputError("--patience", f"is {self.patience:g} s", f"give more than 0 and at most {LONGEST:g} s")


class IsolatedSlave:
    """The component that `make` gives of an FMU, living in a worker process; see `Component` for the methods.

    `write` keeps the values until they are wanted, and a step reads the outputs as well: what the FMU has to say
    against either is raised by the step.

    Args:
        make: called in the worker with the FMU and the name; has to be picklable, as classes and functions are.

    Raises (any method):
        FmuError: the FMU crashed, ended its process or gave no answer in time; the worker is gone then.
        ServotwinError: what the component itself raised.
    """

    def __init__(self, make: Make, fmu: FmuFile, name: str, isolation: Isolation) -> None:
        self.name = name
        self.interface = fmu.interface
        self.warnings = 0
        self._patience = isolation.patience
        self._doing: str | tuple[float, float] = "start"
        self._finished: float | None = None  # end of the latest step [s]
        self._written: Sequence[float] | None = None  # inputs that the FMU has not been given
        self._known: Sequence[float] | None = None  # outputs, where they are up to date
        self._said: deque[str] = deque(maxlen=3)
        self._inputs, self._outputs = messages.numbers(0), messages.answer(0)
        self._bound: tuple[list[str], list[str]] = [], []
        self._texts = Texts()
        self._fmu, self._make = fmu, make
        self._worker: _Worker | None = None
        self._start()

    def set(self, values: Mapping[str, Value]) -> None:
        self._call("set values", "set", dict(values))

    def begin(self, start: float, stop: float | None, tolerance: float | None = None) -> None:
        self._call("enter initialisation", "begin", start, stop, tolerance)

    def bind(self, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        self._bound = list(inputs), list(outputs)
        self._call("choose its inputs and outputs", "bind", *self._bound)
        self._inputs, self._outputs = messages.numbers(len(inputs)), messages.answer(len(outputs))

    def write(self, values: Sequence[float]) -> None:
        self._written, self._known = values, None

    def read(self) -> Sequence[float]:
        if self._known is None:
            self._doing = "get outputs"
            self._known = self._exchanged(0)
        return self._known

    @property
    def texts(self) -> Mapping[str, tuple[str, ...]]:
        return self._texts.known

    def expect(self, arrivals: Sequence[Arrival]) -> None:
        self._call("take ticks", "expect", list(arrivals))

    def passed(self) -> Sequence[Tick]:
        known = self._known
        said = self._call("give its ticks", "ticked")
        self._known = known
        try:
            return [Tick(float(time), frozenset(map(str, clocks)), [*map(float, own)]) for time, clocks, own in said]
        except (TypeError, ValueError):
            raise self._failure("what came from its process cannot be read") from None

    def run(self) -> None:
        self._call("initialise", "run")

    def get(self, name: str) -> Value:
        return self._value(self._call(f"get {name}", "get", name))

    def tune(self, name: str, value: Value) -> Value:
        return self._value(self._call(f"set {name} = {value}", "tune", name, value))

    def _value(self, said: Any) -> Value:
        if not isinstance(said, float | int | str):
            raise self._failure("what came from its process cannot be read")
        return said

    def step(self, time: float, duration: float) -> None:
        self._doing = time, duration
        self._known = None
        self._known = self._exchanged(messages.STEP, time, duration)
        self._finished = time + duration

    def save(self) -> Any:
        return self._call("save its state", "save"), self._finished

    def restore(self, state: Any) -> None:
        number, self._finished = state
        self._call("restore its state", "restore", number)

    def drop(self, state: Any) -> None:
        if self._worker is not None:
            self._call("free a saved state", "drop", state[0])

    def terminate(self) -> None:
        if self._worker is None:
            return
        try:
            self._call("terminate", "terminate")
        except FmuError as error:
            LOG.warning("%s", error)

    def reset(self) -> bool:
        self._written = self._finished = None
        self._said.clear()
        self._texts.clear()
        if self._worker is None:
            self._start()
            self.bind(*self._bound)
        else:
            self._call("reset", "reset")
        return False

    def close(self) -> None:
        """Free everything. An FMU that crashes or hangs over it is logged: what it has computed is whole."""
        if self._worker is None:
            REPEATS.sum_up(self.name)
            return
        self._written = None
        try:
            self._call("free its instance", "close")
            self._doing = "unload"
            code = self._worker.finish(self._patience)
            if code != 0:
                raise self._hang(self._patience) if code is None else self._crash(code)
        except FmuError as error:
            LOG.warning("%s", error)
        finally:
            self._end()
            REPEATS.sum_up(self.name)

    def _start(self) -> None:
        self._worker = _Worker(self._fmu.folder)
        try:
            self._call("start", "prepare", self._make, self._fmu, self.name, patience=_STARTING)
            self._call("instantiate", "make")
        except BaseException:
            self._end()
            raise

    def _call(self, action: str, method: str, *arguments: Any, patience: float | None = None) -> Any:
        """What a method of the component returns; `action` is how errors call it."""
        if self._written is not None:
            self.read()
        self._doing, self._known = action, None
        result, self.warnings = self._ask(messages.CALL, pickle.dumps((method, arguments)), patience)
        return result

    def _exchanged(self, flags: int, time: float = 0.0, duration: float = 0.0) -> Sequence[float]:
        """The outputs, after the inputs that wait and, where it is flagged, a step."""
        written, self._written = self._written, None
        if written is None:
            order = messages.ORDER.pack(flags, time, duration)
        else:
            order = messages.ORDER.pack(flags | messages.WRITE, time, duration) + self._inputs.pack(*written)
        outputs: Sequence[float]
        outputs, self.warnings = self._ask(messages.EXCHANGE, order)
        return outputs

    def _ask(self, kind: bytes, body: bytes, patience: float | None = None) -> Any:
        """What comes back, within this patience or the usual one."""
        worker = self._worker
        if worker is None:
            raise FmuError(self.name, "its process has ended", "reset it")
        try:
            worker.line.send(kind, body)
        except EOFError:
            pass  # what it said before it ended is still to be read
        except BaseException:
            self._end()
            raise
        return self._receive(worker, self._patience if patience is None else patience)

    def _receive(self, worker: _Worker, patience: float) -> Any:
        """The answer; without one the worker is ended."""
        try:
            return self._answered(worker.line, monotonic() + patience)
        except ServotwinError:
            raise
        except EOFError:
            raise self._crash(worker.wait(_DYING)) from None
        except TimeoutError:
            raise self._hang(patience) from None
        except (ValueError, TypeError, LookupError, AttributeError, struct.error) as error:
            raise self._failure("what came from its process cannot be read") from error
        except BaseException:
            self._end()
            raise

    def _answered(self, line: MessagePipe, deadline: float) -> Any:
        """(result, warnings) or (outputs, warnings); log messages on the way go to the log."""
        while True:
            kind, body = line.receive(deadline)
            if kind == messages.VALUES:
                warnings, *outputs = self._outputs.unpack_from(body)
                for variable, text in json.loads(body[self._outputs.size :] or b"[]"):
                    self._texts.number(str(variable), str(text))
                return outputs, warnings
            said = json.loads(body)
            if kind == messages.ERROR:
                name, place, problem, fix = said
                raise _ERRORS[name](place, problem, fix)
            if kind == messages.RESULT:
                result, warnings = said
                return result, warnings
            logger, level, message = said
            self._said.append(message.removeprefix(f"{self.name}: "))
            logging.getLogger(logger).log(level, "%s", message)

    def _crash(self, code: int | None) -> FmuError:
        if code is None:
            return self._failure("its FMU closed the connection to its process")
        if code < 0:
            return self._failure(f"its FMU crashed (signal {_signal(-code)})")
        return self._failure(f"its FMU ended the process it runs in (exit code {code})")

    def _hang(self, patience: float) -> FmuError:
        return self._failure(f"its FMU hangs, without an answer for {patience:g} s,", "give it more --patience, or ")

    def _failure(self, problem: str, remedy: str = "") -> FmuError:
        """The error, after which there is no worker any more."""
        self._end()
        if isinstance(self._doing, str):
            where = f"when it was to {self._doing}"
        else:
            where = "in the step from t = {:g} s by {:g} s".format(*self._doing)
        last = "it had not finished a step"
        if self._finished is not None:
            last = f"the last step it finished ended at t = {self._finished:g} s"
        said = f" ({'; '.join(self._said)})" if self._said else ""
        return FmuError(self.name, f"{problem} {where}{said}; {last}", f"{remedy}ask its supplier for a repaired one")

    def _end(self) -> None:
        worker, self._worker = self._worker, None
        if worker is not None:
            worker.kill()


class _Worker:
    """A process that serves one component, in a session of its own: a terminal's interrupt does not reach it.

    Whatever the FMU starts belongs to its process group and ends with it.
    """

    def __init__(self, folder: Path) -> None:
        life, held = os.pipe()
        self._held = os.fdopen(held, "wb", buffering=0)
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-u", "-c", _BOOT.format(path=sys.path, life=life)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                bufsize=0,
                pass_fds=[life],
                start_new_session=True,
                env=os.environ | {"TMPDIR": str(folder)},
            )
        finally:
            os.close(life)
        assert self._process.stdin is not None and self._process.stdout is not None
        self.line = MessagePipe(self._process.stdout.fileno(), self._process.stdin.fileno())

    def wait(self, patience: float) -> int | None:
        """Its exit code, None if it does not end in this time [s]."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            return self._process.wait(patience)
        return None

    def finish(self, patience: float) -> int | None:
        """Its exit code, after it was let go."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        return self.wait(patience)

    def kill(self) -> None:
        """End it and what it has started."""
        if sys.platform == "win32":
            self._process.kill()
        else:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout, self._held):
            assert pipe is not None
            pipe.close()


@contextlib.contextmanager
def scratch(isolation: Isolation | None) -> Iterator[Path]:
    """A temporary folder; with isolation all others are made in it, and it goes also when this process is killed."""
    if isolation is None:
        with tempfile.TemporaryDirectory(prefix="servotwin-") as folder:
            yield Path(folder)
        return
    folder = tempfile.mkdtemp(prefix="servotwin-")
    janitor = subprocess.Popen(
        ["/bin/sh", "-c", _CLEAR, folder],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    former, tempfile.tempdir = tempfile.tempdir, folder
    try:
        yield Path(folder)
    finally:
        tempfile.tempdir = former
        shutil.rmtree(folder, ignore_errors=True)
        janitor.communicate(b"\n")


def _signal(number: int) -> str:
    return next((known.name for known in signal.Signals if known == number), str(number))
