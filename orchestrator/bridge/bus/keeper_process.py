"""The bus in a process of its own, the only one that sends: steps cannot block, stop or crash it.

The steps write their outputs into a socket, each a heartbeat; received values are in memory that both share. No
heartbeat, or nobody at the other end of the socket: safe values go out. What a terminal or a supervisor sends it leaves
alone, and ends when the steps do.
"""

from __future__ import annotations

import gc
import logging
import os
import select
import signal
import socket
import struct
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from threading import Event, Lock, Thread
from typing import NoReturn

from fmus.errors import BusError, ServotwinError
from orchestrator.bridge.bus.board import Board
from orchestrator.bridge.bus.keeper import Keeper
from orchestrator.bridge.bus.traffic import BusTraffic, on_buses
from orchestrator.bridge.bus.traffic_report import TrafficReport
from orchestrator.bridge.mapping import Coupling
from orchestrator.can.live.bus import BusSettings
from orchestrator.processes import last_words
from orchestrator.progress import Figures
from orchestrator.realtime.pacing import SWITCHING
from orchestrator.realtime.priority import short_time_slices
from orchestrator.trace import FloatArray

_BEGIN, _END = -2, -1  # instead of the number of a step; with the instant of the first, and the number of the last
_TELLING = 0.5  # between two reports of how it goes [s]
_ENDING = 10.0  # patience with the process at the end [s]
_NAP = 0.001  # between two looks whether it has begun [s]
_TROUBLE, _OVER = 1, 2  # what the steps are told
_DEAF = [signal.SIGINT, signal.SIGTERM]
if sys.platform != "win32":
    _DEAF += [signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP, signal.SIGTTOU, signal.SIGTTIN]


class _ProcessKeeper:
    """What the steps have of it."""

    def __init__(
        self,
        buses: Sequence[BusSettings],
        board: Board,
        steps: socket.socket,
        news: Connection,
        coupling: Coupling,
        step: float,
        process: int,
    ) -> None:
        self._buses, self._board, self._steps, self._news, self._process = buses, board, steps, news, process
        self._coupling, self._step, self._place = coupling, step, _place(buses)
        self._number = -1
        self._seen, self._written, self._still = 0.0, 0, 0.0  # its last sign of life, and for how long there was none
        self._lost, self._over = False, Event()
        self._form = struct.Struct(f"qd{len(coupling.outputs)}d")
        self._report = TrafficReport.of_nobody(coupling)
        self._status = Figures.of("", {})
        self._thread = Thread(target=self._listen, name="news of the bus", daemon=True)

    def opened(self, say: Callable[[str], None]) -> None:
        """Wait until the bus is open."""
        try:
            failure = self._news.recv()
        except EOFError:
            failure = self._gone()
        if failure is not None:
            raise failure
        self._say = say
        self._thread.start()

    def begin(self, start: float) -> None:
        written = self._board.writings
        self._tell(_BEGIN, start, [0.0] * len(self._coupling.outputs))
        until = time.monotonic() + self._coupling.rules.give_up
        while self._board.writings == written and not self._lost and time.monotonic() < until:
            time.sleep(_NAP)  # the first step is to have what came before it

    def inputs(self, now: float) -> FloatArray:
        return self._board.read()

    def send(self, number: int, outputs: Sequence[float], now: float, deadline: float) -> None:
        self._number = number
        self._tell(number, deadline, outputs)
        written, since, self._seen = self._board.writings, now - self._seen, now
        self._still = self._still + min(since, self._step) if written == self._written else 0.0  # pauses are no matter
        self._written = written
        if self._still > self._coupling.rules.give_up:
            problem = f"the process that has the bus has taken nothing for {self._still:.3g} s"
            raise BusError(self._place, problem, "see what keeps it")

    def ends(self, endures: bool) -> bool:
        if self._lost:
            raise self._gone()
        return bool(self._board.flags & (_OVER if endures else _OVER | _TROUBLE))

    def status(self, now: float) -> Figures:
        return self._status

    def end(self) -> TrafficReport:
        self._over.set()
        self._steps.settimeout(min(self._coupling.rules.give_up, _ENDING))  # it is to hear of it after all the rest
        with suppress(ServotwinError):
            if self._tell(_END, self._number, [0.0] * len(self._coupling.outputs)):
                self._thread.join(_ENDING)
        if self._thread.is_alive():
            _kill(self._process)
            self._thread.join()
        return self._report

    def release(self) -> None:
        """Nothing is stepped any more."""
        self._over.set()
        self._steps.close()  # the process ends with this

    def _tell(self, number: int, stamp: float, values: Sequence[float]) -> bool:
        """Whether there was room for it; the latest that is there counts."""
        try:
            self._steps.send(self._form.pack(number, stamp, *values))
        except BlockingIOError:
            return False
        except OSError:
            raise self._gone() from None
        return True

    def _gone(self) -> BusError:
        return BusError(self._place, "the process that has the bus is gone", "stop the machine by hand")

    def _listen(self) -> None:
        """Pass on what the process says, to its report; where it dies before that, do its last work.

        Whether steps go on or hang then, this thread does not wait for them.
        """
        with suppress(EOFError, OSError):
            while not isinstance(news := self._news.recv(), TrafficReport):
                if isinstance(news, Figures):
                    self._status = news
                else:
                    self._say(news)
            self._report = news
            return
        self._lost = True
        self._report = self._in_its_place()
        patience = 2 * self._coupling.rules.give_up
        if not self._over.wait(patience):
            why = f"{self._gone().problem}, and no step has ended for {patience:g} s"
            last_words.own().say(last_words.KILLED, why)
            _kill(os.getpid())

    def _in_its_place(self) -> TrafficReport:
        """Send the safe values from here."""
        try:
            with on_buses(self._buses, self._coupling, self._step, self._say) as traffic:
                for _ in range(2):  # counters begin anew: one of two values is another than the last
                    traffic.end(0.0)
                report = traffic.report(0.0)
        except Exception:  # drivers raise anything
            return self._report
        sent = report.doubt() if report.unconfirmed else "safe values were sent by the process that steps"
        self._say(f"{self._place}: {sent}")
        return replace(report, trouble=report.trouble or self._report.trouble)


@contextmanager
def apart(
    buses: Sequence[BusSettings],
    coupling: Coupling,
    step: float,
    say: Callable[[str], None],
    kills: bool,
    rescue: Callable[[], str] = lambda: "",
) -> Iterator[Keeper]:
    """Have the buses in a child of this process.

    Args:
        kills: whether it ends this process where no step ends for longer than `give_up`.
        rescue: called in the child where this process is gone before its time, when the bus is closed; what it returns
            is said.

    Raises:
        BusError: the adapter does not open.
    """
    if sys.platform == "win32":
        raise OSError("Windows does not fork")
    board = Board(coupling.width)
    steps, theirs = socket.socketpair()
    news, told = Pipe(duplex=False)
    parent, child = os.getpid(), os.fork()
    if not child:
        steps.close()
        news.close()
        _Guard(buses, coupling, step, board, theirs, told, parent if kills else 0).live(rescue)
    theirs.close()
    told.close()
    steps.setblocking(False)
    keeper = _ProcessKeeper(buses, board, steps, news, coupling, step, child)
    try:
        keeper.opened(say)
        yield keeper
    finally:
        keeper.release()
        _await(child)
        news.close()


def _place(buses: Sequence[BusSettings]) -> str:
    return " and ".join(bus.place for bus in buses)


def _kill(process: int) -> None:
    if sys.platform == "win32":
        raise OSError("Windows does not fork")
    os.kill(process, signal.SIGKILL)


def _await(child: int) -> None:
    if sys.platform == "win32":
        raise OSError("Windows does not fork")
    until = time.monotonic() + _ENDING
    with suppress(ChildProcessError):
        while os.waitpid(child, os.WNOHANG) == (0, 0):
            if time.monotonic() > until:
                os.kill(child, signal.SIGKILL)
            time.sleep(0.002)


class _Guard:
    """The process that has the bus."""

    def __init__(
        self,
        buses: Sequence[BusSettings],
        coupling: Coupling,
        step: float,
        board: Board,
        steps: socket.socket,
        news: Connection,
        parent: int,
    ) -> None:
        self._buses, self._coupling, self._step, self._board = buses, coupling, step, board
        self._steps, self._news, self._parent = steps, news, parent
        self._form = struct.Struct(f"qd{len(coupling.outputs)}d")
        self._partial, self._telling = b"", Lock()
        self._start, self._orphan, self._alone = 0.0, False, False

    def live(self, rescue: Callable[[], str]) -> NoReturn:
        """All of the process' life; nothing of what its parent has left is cleaned up by it."""
        code = 1
        try:
            for number in _DEAF:
                signal.signal(number, signal.SIG_IGN)
            gc.freeze()
            sys.setswitchinterval(SWITCHING)
            logging.getLogger().handlers = [_Forward(self._say)]
            with short_time_slices():
                self._work()
            if self._orphan and self._start:
                self._say(rescue() or "there is no result")
            code = 0
        except ServotwinError as error:
            self._fail(error)
        except BaseException as error:
            self._fail(BusError(_place(self._buses), f"the process that has the bus failed ({error!r})"))
        finally:
            os._exit(code)

    def _work(self) -> None:
        awake, wake = socket.socketpair()
        awake.setblocking(False)
        wake.setblocking(False)

        def arrived() -> None:
            with suppress(BlockingIOError):
                wake.send(b".")

        with on_buses(self._buses, self._coupling, self._step, self._say, arrived=arrived) as traffic:
            self._board.write(traffic.inputs, 0)
            self._tell(None)
            self._serve(traffic, awake)
            now = self._now()
            traffic.end(now)
            report = traffic.report(now)
            self._tell(report)
            if self._orphan:
                sent = report.doubt() if report.unconfirmed else "safe values were sent"
                self._say(f"{_place(self._buses)}: the steps are gone; {sent}")

    def _serve(self, traffic: BusTraffic, awake: socket.socket) -> None:
        """Pass values until the steps end."""
        nap, told = max(self._step, 0.002), 0.0
        while True:
            select.select([self._steps, awake], [], [], nap)
            with suppress(BlockingIOError):
                awake.recv(4096)
            records = self._records()
            if records and records[0][0] == _BEGIN:
                self._start = records.pop(0)[1]
                traffic.begin(self._start)
            if records and records[-1][0] == _END:
                traffic.pass_over(int(records[-1][1]))
                return
            if self._orphan:
                return
            if not self._start:
                traffic.listen(time.monotonic())
                continue
            now = self._now()
            traffic.receive(now)
            if now - told >= _TELLING:
                told = now
                self._tell(traffic.status(now))
            self._board.write(traffic.inputs, _OVER * bool(traffic.over) | _TROUBLE * bool(traffic.trouble))
            if records:
                number, deadline, *outputs = records[-1]
                traffic.send(int(number), outputs, now, now - deadline)
                self._alone = False
            else:
                self._watch(traffic, now)

    def _watch(self, traffic: BusTraffic, now: float) -> None:
        """See that steps end: where none has for too long nobody listens, and at last who takes them is ended."""
        if sys.platform == "win32":
            raise OSError("Windows does not fork")
        patience = 2 * self._coupling.rules.give_up  # steps that are only late end it by themselves
        self._alone = traffic.waited(now) > self._step + self._coupling.rules.most_late
        if traffic.watch(now) > patience and self._parent:
            why = f"no step has ended for {patience:g} s"
            self._say(f"{why}: the process that takes them is killed")
            last_words.own().say(last_words.KILLED, why)
            os.kill(self._parent, signal.SIGKILL)
            self._parent = 0

    def _records(self) -> list[tuple[float, ...]]:
        """What the steps have told since the last look."""
        if sys.platform == "win32":
            raise OSError("Windows does not fork")
        try:
            data = self._steps.recv(1 << 20, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data and not self._orphan:
            self._orphan = True
            last_words.own().say(last_words.SAVING, "a coupling")
        data = self._partial + data
        whole = len(data) - len(data) % self._form.size
        self._partial = data[whole:]
        return list(self._form.iter_unpack(data[:whole]))

    def _now(self) -> float:
        return time.monotonic() - self._start if self._start else 0.0

    def _say(self, line: str) -> None:
        self._tell(line)

    def _fail(self, error: ServotwinError) -> None:
        self._tell(str(error) if self._orphan else error)

    def _tell(self, news: object) -> None:
        """Tell the steps, or, where they are gone or stand still, whoever reads what a command says."""
        with suppress(OSError):
            if type(news) is str and (self._alone or self._orphan):
                os.write(2, f"servotwin: {news}\n".encode())
            else:
                with self._telling:
                    self._news.send(news)


class _Forward(logging.Handler):
    """Has log messages of libraries told by the process that steps."""

    def __init__(self, say: Callable[[str], None]) -> None:
        super().__init__(logging.WARNING)
        self._say = say

    def emit(self, record: logging.LogRecord) -> None:
        self._say(record.getMessage())
