"""What a file may say under `expect`; read once and turned into expectations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from orchestrator.scenario.expectations import on_run
from orchestrator.scenario.expectations.base import Condition, Draws, Expected
from orchestrator.scenario.expectations.closeness import KINDS as CLOSE
from orchestrator.scenario.expectations.closeness import Close
from orchestrator.scenario.expectations.combined import AtLeast
from orchestrator.scenario.expectations.events import Crossings, InOrder, ModeChanges, Saturated, Saturations
from orchestrator.scenario.expectations.figure import FigureBounds
from orchestrator.scenario.expectations.funnel import Funnel, FunnelBlock
from orchestrator.scenario.expectations.limits import Above, Below, Near, Pieces, Range
from orchestrator.scenario.expectations.on_run import CountBlock, OnRun, ProcessorTimeBlock, Refusal
from orchestrator.scenario.expectations.on_signal import OnSignal, Says
from orchestrator.scenario.expectations.oscillation import Damping, Distortion, DominantFrequency, LimitCycle
from orchestrator.scenario.expectations.quantities import Share
from orchestrator.scenario.expectations.reference import Follows, Reference, ReferenceBlock
from orchestrator.scenario.expectations.response import (
    Effort,
    FinalValue,
    Iae,
    Ise,
    Itae,
    Monotone,
    Overshoot,
    Peak,
    ResidualRms,
    RiseTime,
    Rms,
    SettlingTime,
    SteadyError,
)
from orchestrator.scenario.expectations.stochastic import MOST_SEEDS, BandBlock, InBand, Often
from orchestrator.scenario.references import Accepted, CaseReferences
from orchestrator.yaml_file import Block, Quantity, Time

FIRST = ("near", "reference", "below", "above", "equals", "refused")
FIGURES = (
    *("range", "final_value", "steady_error", "settling_time", "rise_time", "overshoot", "residual_rms", "peak"),
    *("monotone", "rms", "iae", "ise", "itae", "effort", "frequency", "damping", "distortion", "limit_cycle"),
    *("crossings", "saturations", "saturated", "mode_changes"),
)
AGAINST = ("within", "funnel", *CLOSE, "band")
TOGETHER = ("all", "any", "some", "warn", "in_order")
WITHOUT_SIGNAL = ("refused", *on_run.KINDS, *TOGETHER)


def _word(kind: type[Block], words: Mapping[str, Any]) -> BeforeValidator:
    """Words that stand for a block of this kind."""

    def read(value: Any) -> Any:
        if isinstance(value, str) and value not in words:
            raise ValueError(f"write {' or '.join(words)}, or keys: {', '.join(kind.model_fields)}")
        return words[value] if isinstance(value, str) else value

    return BeforeValidator(read, json_schema_input_type=kind | Literal[tuple(words)] | None)


NONE = _word(FigureBounds, {"none": {"at_most": 0}})
NO_WARNINGS = _word(CountBlock, {"none": {"at_most": 0}})
NO_LIMIT_CYCLE = _word(LimitCycle, {"none": {"none_above": 0}})
RISING_OR_FALLING = _word(Monotone, {way: {"direction": way} for way in ("rising", "falling")})


@dataclass(frozen=True)
class ReferenceSources:
    """Where references are found.

    Attributes:
        base: folder that their files are relative to.
        said: takes what is to be known of them.
        accepted: those that are kept of the case.
    """

    base: Path
    said: list[str] | None
    accepted: CaseReferences | None

    def reference(self, block: ReferenceBlock | Accepted, signal: str) -> Reference:
        """The reference for a signal.

        Raises:
            TraceError: it cannot be read, or is not fit to be one.
        """
        if isinstance(block, ReferenceBlock):
            return block.reference(signal, self.base, self.said)
        assert self.accepted is not None
        file = self.accepted.file(block)
        missing = f"no {file}, which `servotwin accept {self.accepted.scenario}` writes"
        trace, step = self.accepted.trace(block, signal)
        return Reference(trace, "its reference", file, accepted=True, missing=missing, step=step)


class OrderedEventBlock(Block):
    """Events of a signal, as a step of `in_order`.

    Attributes:
        signal: component.variable that they are looked for in.
    """

    signal: str
    crossings: Crossings | None = None
    saturations: Saturations | None = None
    mode_changes: ModeChanges | None = None

    @model_validator(mode="after")
    def _one_kind(self) -> OrderedEventBlock:
        if sum(kind is not None for kind in self._kinds) != 1:
            raise ValueError("give one of crossings, saturations, mode_changes")
        return self

    @property
    def _kinds(self) -> tuple[Condition | None, ...]:
        return self.crossings, self.saturations, self.mode_changes

    def step(self, after: float | None, before: float | None) -> OnSignal:
        """The events that are looked for."""
        return OnSignal(self.signal, next(kind for kind in self._kinds if kind is not None), after, before)


class SomeBlock(Block):
    """At least so many of these hold.

    Attributes:
        least: how many.
        of: the expectations.
    """

    least: int = Field(ge=1)
    of: list[ExpectationBlock] = Field(min_length=1)

    @model_validator(mode="after")
    def _enough(self) -> SomeBlock:
        if self.least > len(self.of):
            raise ValueError(f"`least` is {self.least} of {len(self.of)}")
        return self


class ExpectationBlock(Block):
    """Something that must hold: of a signal between two times, of the run, or of other expectations.

    Attributes:
        signal, signals: what it is about; `signals` ask the same of each.
        after, before: which samples it looks at [s], those at both times included; all by default.
        near, within: no sample is farther than `within` from a value, or from the reference.
        below, above: every sample lies below, or above, this value.
        equals: every sample of a text is this one, or one of these.
        reference: a signal of a trace file, or `accepted`, the one that `servotwin accept` keeps of the case, or
            `accepted per platform`, that of this kind of machine; one of `within`, `funnel`, `nrmse`, `fit`,
            `deviation`, `lag` and `band` says how close it is.
        nrmse: root of the mean square distance from the reference, over the reference's range.
        fit: 1 where it is equal to the reference, 0 where it is no closer than the reference's mean.
        deviation: largest distance from the reference [unit of the signal].
        lag: by how much it comes earlier or later than the reference, where both go together best [s].
        seeds, share, vary: it holds in that share of so many more runs that differ by the seeds of components, of these
            or of all that are given one.
        refused: words of the error that the run ends in.
        range: bounds piece by piece, each `to` a time.
        warnings, steps, iterations, real_time_factor, processor_time, frames_lost, late_steps: of the run.
        all, any, some, warn, in_order: of others; what stands under `warn` is told, but fails nothing.

    Numbers are in the signal's unit, or have their own: `90 deg`.
    """

    signal: str | None = None
    signals: list[str] | None = Field(None, min_length=1)
    after: Time | None = None
    before: Time | None = None

    near: float | Quantity | None = None
    below: float | Quantity | None = None
    above: float | Quantity | None = None
    equals: str | Annotated[list[str], Field(min_length=1)] | None = None
    range: Pieces | None = None

    reference: ReferenceBlock | Accepted | None = None
    within: Annotated[float, Field(ge=0)] | Quantity | None = None
    funnel: FunnelBlock | None = None
    nrmse: FigureBounds | None = None
    fit: FigureBounds | None = None
    deviation: FigureBounds | None = None
    lag: FigureBounds | None = None
    band: BandBlock | None = None

    seeds: int | None = Field(None, ge=1, le=MOST_SEEDS)
    share: Share | None = Field(None, gt=0, le=1)
    vary: list[str] | None = Field(None, min_length=1)

    final_value: FinalValue | None = None
    steady_error: SteadyError | None = None
    settling_time: SettlingTime | None = None
    rise_time: RiseTime | None = None
    overshoot: Overshoot | None = None
    residual_rms: ResidualRms | None = None
    peak: Peak | None = None
    monotone: Annotated[Monotone | None, RISING_OR_FALLING] = None
    rms: Rms | None = None
    iae: Iae | None = None
    ise: Ise | None = None
    itae: Itae | None = None
    effort: Effort | None = None
    frequency: DominantFrequency | None = None
    damping: Damping | None = None
    distortion: Distortion | None = None
    limit_cycle: Annotated[LimitCycle | None, NO_LIMIT_CYCLE] = None
    crossings: Crossings | None = None
    saturations: Saturations | None = None
    saturated: Saturated | None = None
    mode_changes: ModeChanges | None = None

    refused: str | None = None
    warnings: Annotated[CountBlock | None, NO_WARNINGS] = None
    steps: CountBlock | None = None
    iterations: FigureBounds | None = None
    real_time_factor: FigureBounds | None = None
    processor_time: ProcessorTimeBlock | None = None
    frames_lost: Annotated[FigureBounds | None, NONE] = None
    late_steps: Annotated[FigureBounds | None, NONE] = None

    all: list[ExpectationBlock] | None = Field(None, min_length=1)
    any: list[ExpectationBlock] | None = Field(None, min_length=1)
    some: SomeBlock | None = None
    warn: ExpectationBlock | None = None
    in_order: list[OrderedEventBlock] | None = Field(None, min_length=2)

    @model_validator(mode="after")
    def _one_kind(self) -> ExpectationBlock:
        kinds, close = self._given((*FIRST, *FIGURES, *on_run.KINDS, *TOGETHER)), self._given(AGAINST)
        if close and close != ["within"] and "reference" not in kinds:
            raise ValueError(f"`{next(name for name in close if name != 'within')}` goes with `reference`")
        if len(kinds) != 1:
            found = f", not {' and '.join(kinds)}" if kinds else ""
            raise ValueError(f"give one of {', '.join(FIRST)} or of the other kinds{found}")
        if kinds == ["reference"] and len(close) != 1:
            raise ValueError(f"`reference` goes with one of {', '.join(AGAINST)}")
        if (kinds == ["near"] and close != ["within"]) or (close and kinds[0] not in ("near", "reference")):
            raise ValueError("`within` goes with `near` and `reference`")
        if isinstance(self.within, str) and self.within.strip().startswith("-"):
            raise ValueError("`within` must not be negative")
        if (self.signal is None and self.signals is None) != (kinds[0] in WITHOUT_SIGNAL):
            raise ValueError("`signal` goes with everything but `refused`, the run and what is made of others")
        if self.signal is not None and self.signals is not None:
            raise ValueError("give `signal` or `signals`")
        self._check_draws(kinds[0])
        if kinds[0] in WITHOUT_SIGNAL and kinds[0] != "in_order" and self._given(("after", "before")):
            raise ValueError(f"`after` and `before` do not go with `{kinds[0]}`")
        return self

    def _check_draws(self, kind: str) -> None:
        """See that what differs from run to run is said where it has a meaning."""
        if (self.seeds is None) != (self.share is None):
            raise ValueError("`seeds` and `share` go together")
        if self.vary is not None and self.seeds is None:
            raise ValueError("`vary` goes with `seeds`")
        if self.seeds is not None and (kind in WITHOUT_SIGNAL or kind == "equals" or self.band is not None):
            raise ValueError("`seeds` go with what is asked of a signal of numbers; `band` has `seeds` of its own")

    @property
    def of_a_case(self) -> bool:
        """Whether it is another one in each case, for it has a reference of each."""
        return isinstance(self.reference, str) or any(block.of_a_case for block in self._others)

    def expectations(
        self, base: Path, said: list[str] | None = None, accepted: CaseReferences | None = None
    ) -> tuple[Expected, ...]:
        """What must hold, one a signal; files are relative to `base`, what is to be known of them is added to `said`.

        Args:
            accepted: the references that are kept of the case.

        Raises:
            TraceError: a reference cannot be read.
        """
        sources = ReferenceSources(base, said, accepted)
        names = self.signals or ([] if self.signal is None else [self.signal])
        if not names:
            return (self._of_the_run(base) or self._of_others(sources),)
        if self.equals is not None:
            words = (self.equals,) if isinstance(self.equals, str) else tuple(self.equals)
            return tuple(Says(name, words, self.after, self.before) for name in names)
        return tuple(OnSignal(name, self._drawn(name, sources), self.after, self.before) for name in names)

    def expectation(
        self, base: Path, said: list[str] | None = None, accepted: CaseReferences | None = None
    ) -> Expected:
        """All of them as one."""
        parts = self.expectations(base, said, accepted)
        return parts[0] if len(parts) == 1 else AtLeast(len(parts), parts, "all of")

    def _given(self, names: Sequence[str]) -> list[str]:
        return [name for name in names if getattr(self, name) is not None]

    def _drawn(self, signal: str, sources: ReferenceSources) -> Condition:
        condition = self._condition(signal, sources)
        if self.seeds is None or self.share is None:
            return condition
        return Often(condition, Draws(self.seeds, tuple(self.vary or ())), self.share)

    def _condition(self, signal: str, sources: ReferenceSources) -> Condition:
        if self.reference is not None:
            return self._against(sources.reference(self.reference, signal))
        if self.near is not None and self.within is not None:
            return Near(self.near, self.within)
        if self.below is not None:
            return Below(self.below)
        return self._figure() if self.above is None else Above(self.above)

    def _figure(self) -> Condition:
        (name,) = self._given(FIGURES)
        given = getattr(self, name)
        return given if isinstance(given, Condition) else Range(pieces=given)

    def _against(self, reference: Reference) -> Condition:
        if self.within is not None:
            return Follows(reference, self.within)
        if self.funnel is not None:
            return Funnel(reference, self.funnel)
        if self.band is not None:
            return InBand(reference, self.band)
        (name,) = self._given(tuple(CLOSE))
        return Close(reference, name, getattr(self, name))

    def _of_the_run(self, base: Path) -> Expected | None:
        if self.refused is not None:
            return Refusal(self.refused)
        for name in self._given(tuple(on_run.KINDS)):
            return OnRun(name, on_run.plain(getattr(self, name), base))
        return None

    @property
    def _others(self) -> list[ExpectationBlock]:
        """Those that it is made of."""
        return self.all or self.any or (self.some.of if self.some else [self.warn] if self.warn else [])

    def _of_others(self, sources: ReferenceSources) -> Expected:
        if self.in_order is not None:
            return InOrder(tuple(step.step(self.after, self.before) for step in self.in_order))
        parts = tuple(block.expectation(sources.base, sources.said, sources.accepted) for block in self._others)
        if self.warn is not None:
            return AtLeast(1, parts, "warn", needed=False)
        if self.some is not None:
            return AtLeast(self.some.least, parts, f"{self.some.least} of {len(parts)}")
        return AtLeast(len(parts) if self.all else 1, parts, "all of" if self.all else "any of")
