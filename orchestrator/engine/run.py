"""What a run is asked for, and what it gives."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction

from fmus.errors import PartialError
from orchestrator.engine.account import Account
from orchestrator.engine.compiled import Engine
from orchestrator.engine.iterated import StepControl
from orchestrator.engine.loop import Statistics
from orchestrator.engine.planning.plan import REFUSED, CycleSettings, Order
from orchestrator.engine.tuned import ValueChange
from orchestrator.fmi.interface import Value
from orchestrator.network.carriers import BusRecord
from orchestrator.realtime.deadlines import Deadlines
from orchestrator.trace import FloatArray, Trace


@dataclass(frozen=True)
class Timing:
    """When a run starts and stops and how it steps; exact times [s].

    Attributes:
        tolerance: relative tolerance that FMUs with a solver of their own are told; none by default.
        tell_stop: whether FMUs are told when the run stops; some then refuse to go beyond by a rounding error.
        finite: whether an output that is not finite ends the run.
        control: how steps inside the communication step are chosen; None where it is one.
    """

    stop: Fraction
    step: Fraction
    start: Fraction = Fraction(0)
    order: Order = Order.GAUSS_SEIDEL
    cycles: CycleSettings = REFUSED
    engine: Engine = Engine.AUTO
    tolerance: float | None = None
    tell_stop: bool = False
    finite: bool = True
    control: StepControl | None = None

    def finer(self, parts: int) -> Timing:
        """The same with so many steps in the place of one; where a tolerance has steps be as long as they are, with one
        that has them be so much shorter, for the error of a step goes with its cube."""
        control = self.control
        if control is not None:
            control = replace(control, tolerance=control.tolerance / parts**3, least=control.least / parts)
        return replace(self, step=self.step / parts, control=control)


@dataclass(frozen=True)
class Run:
    """What may differ from run to run of one system; see `Simulation.run`."""

    values: Mapping[str, Value] = field(default_factory=dict)
    stimuli: Mapping[str, FloatArray] = field(default_factory=dict)
    record: Iterable[str] | None = None
    stop: Fraction | None = None
    record_every: int = 1


@dataclass(frozen=True)
class Result:
    """What a run gave.

    Attributes:
        trace: the recorded variables, named component.variable, one row every so many communication steps; without
            rows where the record went to a sink.
        statistics: component -> calls and seconds.
        warnings: component -> number of warnings its FMU returned.
        iterations: steps of cycles that were taken and taken back.
        account: how it was stepped, and how far.
        ended: what an FMU said that asked to stop before the run was over; nothing where none did.
        changes: what was changed between steps, in order.
        deadlines: how they were kept by a run in real time.
        carried: bus -> what it has carried.
        intermediate: component -> what it gave within its steps, where that was to be kept.
    """

    trace: Trace
    statistics: Mapping[str, Statistics]
    warnings: Mapping[str, int]
    iterations: int
    account: Account
    ended: str = ""
    changes: Sequence[ValueChange] = ()
    deadlines: Deadlines | None = None
    carried: Mapping[str, BusRecord] = field(default_factory=dict)
    intermediate: Mapping[str, Trace] = field(default_factory=dict)


class Interrupted(KeyboardInterrupt):
    """A run was interrupted; `result` is what it gave until then, to the last whole tick.

    From one process to another it travels as a plain KeyboardInterrupt.
    """

    def __init__(self, result: Result) -> None:
        super().__init__(f"interrupted at t = {result.account.reached:g} s")
        self.result = result

    def __reduce__(self) -> tuple[type, tuple[str]]:
        return KeyboardInterrupt, (str(self),)


class RunFailed(PartialError):  # noqa: N818 - as what interrupts it
    """An FMU failed while a run was stepped."""

    result: Result
