"""What every expectation is: something that is asked of a run, and what comes of asking.

`Expected` is the contract. A kind of question about the samples of one signal is a `Condition`, which `on_signal` asks
of a window; the other kinds (of the run, of several expectations) are expectations themselves.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Self

from fmus.errors import ServotwinError
from orchestrator.crossing import Crossing
from orchestrator.engine import Result
from orchestrator.fmi.interface import Port
from orchestrator.scenario.expectations.quantities import Dimension
from orchestrator.trace import FloatArray, Trace

DrawnTraces = Mapping[tuple[str, ...], Sequence[Trace]]
"""Components whose seeds vary -> traces of like runs with other noise, of the signals that are wanted so."""
Times = tuple[float, float]
"""From when to when [s]; infinite where that is the begin or end of the run."""
Tube = tuple[FloatArray, FloatArray]
"""(K,) lower and upper bounds [unit of the signal]; infinite where there is none."""


@dataclass(frozen=True)
class Check:
    """How an expectation turned out: what was asked, whether it held, and the figure that decided.

    Attributes:
        found: the figure in words, with its unit.
        figure: None where there is none, or it is no number.
        margin: how far it is from where the answer would turn, negative where it did not hold [unit of the figure].
        unit: of figure and margin, "" where they have none.
        needed: whether the case fails where it does not hold; else that is a warning.
        doubt: why the question is not a good one, "" where it is.
        parts: what it was made of.
    """

    text: str
    held: bool
    found: str
    figure: float | None = None
    margin: float | None = None
    unit: str = ""
    needed: bool = True
    doubt: str = ""
    parts: tuple[Check, ...] = ()

    @property
    def failed(self) -> bool:
        """Whether the case fails because of it."""
        return self.needed and not self.held


@dataclass(frozen=True)
class Draws:
    """Runs that differ by their noise alone.

    Attributes:
        vary: components whose seeds differ from run to run; all that are given one where none is named.
    """

    count: int
    vary: tuple[str, ...] = ()


@dataclass(frozen=True)
class Ran:
    """What there is of a run to be judged.

    Attributes:
        trace: None where it ended in an error.
        result: how it was stepped, where that is known.
        processor: processor time that this process took for it [s], where that is known.
        case: its name.
        bus: counts of what happened on a bus, by name; None where there was none.
        draws: like runs with other noise.
    """

    trace: Trace | None
    error: ServotwinError | None = None
    result: Result | None = None
    processor: float | None = None
    case: str = ""
    bus: Mapping[str, int] | None = None
    draws: DrawnTraces = field(default_factory=dict)


@dataclass
class ExpectationScope:
    """The variables that expectations are about.

    Attributes:
        port: the variable of a name; raises a WiringError naming the place (second argument) where there is none.
        crossings: how references got into the units of their variables, as they are brought there.
    """

    port: Callable[[str, str], Port]
    crossings: list[Crossing] = field(default_factory=list)


class Expected(ABC):
    """Something that is asked of a run; its text says it in words."""

    @property
    def signals(self) -> tuple[str, ...]:
        """component.variable that have to be recorded."""
        return ()

    @property
    def refuses(self) -> bool:
        """Whether it may hold of a run that ends in an error."""
        return False

    @property
    def drawn(self) -> tuple[tuple[str, Draws], ...]:
        """component.variable that it wants to see with other noise, and how often."""
        return ()

    @property
    def files(self) -> tuple[Path, ...]:
        """The references that it compares with."""
        return ()

    @property
    def accepted(self) -> bool:
        """Whether it compares with a reference that was accepted of the case, as its file has it."""
        return any(leaf.accepted for leaf in self.leaves if leaf is not self)

    @property
    def until(self) -> float:
        """When the last sample comes that it looks at [s]; infinite where that is the end of the run."""
        return float("inf")

    @property
    def leaves(self) -> tuple[Expected, ...]:
        """What it is made of in the end; itself where it is not made of others."""
        return (self,)

    def brought(self, wiring: ExpectationScope) -> Self:
        """The same with numbers and references in the units of the variables.

        Raises:
            WiringError: a unit of another quantity, or no such variable.
        """
        return self

    def check_covered(self, instants: FloatArray) -> None:
        """See, before a run with these instants (K,) [s], that references last as long as it is compared with them.

        Raises:
            ScenarioError: one does not.
            TraceError: it has a NaN there.
        """
        return

    @abstractmethod
    def check(self, ran: Ran) -> Check:
        """Judge a run.

        Raises:
            ScenarioError: the question does not fit the run: there is no sample between the times, say.
            TraceError: a signal was not recorded.
        """


@dataclass(frozen=True)
class Judgement:
    """What a condition says of samples.

    Attributes:
        found: in words, without the unit.
        dimension: of the figure.
        more: what is to be said besides, after the unit.
        doubt: as in `Check`.
    """

    held: bool
    found: str
    figure: float | None = None
    margin: float | None = None
    dimension: Dimension = Dimension.DISTANCE
    more: str = ""
    doubt: str = ""


class Condition(ABC):
    """What is asked of the samples of a signal; its text says it in words."""

    takes_nonfinite: ClassVar[bool] = False
    """Whether it can judge samples that are NaN or infinite; else it does not hold of them."""

    @property
    def draws(self) -> Draws | None:
        """Runs with other noise that it wants to see, besides the run itself."""
        return None

    @property
    def files(self) -> tuple[Path, ...]:
        """The references that it compares with."""
        return ()

    @property
    def accepted(self) -> bool:
        """As in `Expected`."""
        return False

    def brought(self, place: str, port: Port, wiring: ExpectationScope) -> Self:
        """As in `Expected`, for the variable that it is asked of."""
        return self

    def check_covered(self, place: str, instants: FloatArray, asked: Times) -> None:
        """As in `Expected`, with the instants that it is asked of, and between which times that is [s]."""
        return

    @abstractmethod
    def judged(self, time: FloatArray, values: FloatArray, hold: bool, draws: Sequence[Trace]) -> Judgement:
        """What it says of values (K,) at stamps (K,) [s], which `hold` until the next or are on lines.

        Args:
            draws: the window of like runs with other noise, of this signal alone.

        Raises:
            TraceError: it cannot be told from these samples.
        """

    def tube(self, time: FloatArray, hold: bool, draws: Sequence[Trace] = ()) -> Tube | None:
        """Between which bounds samples at these stamps (K,) [s] may be, to be drawn; None where it has none.

        Args:
            draws: as in `judged`.
        """
        return None
