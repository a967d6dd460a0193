"""A scenario as plain values: a system, its stimuli, what is recorded, and what must hold, for one case or several."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from orchestrator.assembly.assembly import SystemSpec
from orchestrator.assembly.stimulus import Stimulus
from orchestrator.engine import Timing
from orchestrator.fmi.interface import Value
from orchestrator.scenario.can_block import CanBlock
from orchestrator.scenario.expectations import Draws, Expected
from orchestrator.scenario.parameter_sets import naming_places
from orchestrator.trace import Trace
from orchestrator.yaml_file import naming


@dataclass(frozen=True)
class DataLogger:
    """Samples a run at irregular instants, as hardware does.

    Attributes:
        signals: name in the recording -> component.variable.
        every: mean time between samples [s].
        jitter: standard deviation of that time, as a fraction of it; 0 samples evenly.
        first: time from the start of the run to the first sample [s], `every` by default. Half of it reads what
            sampled components hold in the middle of their period.
        seed: of the random times; each case has other ones.
    """

    signals: Mapping[str, str]
    every: float
    jitter: float = 0.2
    first: float | None = None
    seed: int = 0

    def sample(self, trace: Trace, number: int) -> Trace:
        """What the logger holds of the run with this number: the last value before each of its instants."""
        rng = np.random.default_rng([self.seed, number])
        count = int(1.5 * trace.duration / self.every) + 1
        gaps = self.every * np.maximum(1 + self.jitter * rng.standard_normal(count), 0.01)
        later = self.every * np.arange(1, count + 1) if self.jitter == 0 else np.cumsum(gaps)
        instants = trace.time[0] + later + (0.0 if self.first is None else self.first - later[0])
        names = {source: name for name, source in self.signals.items()}
        chosen = trace.select(names)
        return chosen.resampled(instants[instants <= trace.time[-1]], hold=chosen.names).renamed(names)


@dataclass(frozen=True)
class Case:
    """A variant of a scenario.

    Attributes:
        values: component.variable -> value, all that are set.
        arrays: component.array -> shape of those that it sets as a whole.
        system: what it is run with, None where that is the scenario's.
        expected: all that must hold.
    """

    name: str
    values: Mapping[str, Value] = field(default_factory=dict)
    expected: tuple[Expected, ...] = ()
    arrays: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    system: SystemSpec | None = None

    @property
    def may_be_refused(self) -> bool:
        """Whether it is expected that the run ends in an error."""
        return any(expected.refuses for expected in self.expected)

    @property
    def drawn(self) -> list[tuple[str, Draws]]:
        """The signals that expectations want to see with other noise, and how often."""
        return [wanted for expected in self.expected for wanted in expected.drawn]

    @property
    def looked_at(self) -> dict[str, None]:
        """The signals that expectations look at."""
        return {signal: None for expected in self.expected for signal in expected.signals}


@dataclass(frozen=True)
class Scenario:
    """A system and what is done with it.

    Attributes:
        path: the file it is from.
        stimuli: component.input -> what drives it; without a bus, the safe value of a signal of the bus.
        record: component.variable to be recorded, None for all outputs.
        can: how it is coupled to a CAN bus.
        notes: what was seen in the recordings that it takes, a line each.
        parts: the files that it includes.
        parameter_sets: the files of those that give it values.
        places: component.variable -> where its value stands, of what is given in sets.
    """

    path: Path
    title: str
    description: str
    system: SystemSpec
    timing: Timing
    stimuli: Mapping[str, Stimulus]
    record: tuple[str, ...] | None
    logger: DataLogger | None
    cases: tuple[Case, ...]
    can: CanBlock | None = None
    notes: Sequence[str] = ()
    parts: tuple[Path, ...] = ()
    parameter_sets: tuple[Path, ...] = ()
    places: Mapping[str, str] = field(default_factory=dict)

    @contextmanager
    def naming(self, overrides: Iterable[str] = ()) -> Iterator[None]:
        """Errors about it name its file, and those about values where these stand.

        Args:
            overrides: component.variable that the command line gives a value.
        """
        with naming(self.path), naming_places({**self.places, **dict.fromkeys(overrides, "--set")}):
            yield

    def with_systems(self, change: Callable[[SystemSpec], SystemSpec]) -> Scenario:
        """The scenario with its system, and those that cases have of their own, changed; equal ones once."""
        known = [self.system]
        known += [case.system for case in self.cases if case.system and case.system not in known]
        changed = [change(system) for system in known]
        cases = tuple(replace(case, system=case.system and changed[known.index(case.system)]) for case in self.cases)
        return replace(self, system=changed[0], cases=cases)

    def without_accepted(self) -> Scenario:
        """The scenario for other components or values than its own, of which its accepted references say nothing."""
        kept = (tuple(asked for asked in case.expected if not asked.accepted) for case in self.cases)
        cases = tuple(replace(case, expected=asked) for case, asked in zip(self.cases, kept, strict=True))
        return replace(self, cases=cases)

    def until(self, stop: Fraction) -> Scenario:
        """The scenario up to a time [s], with those expectations alone that look no further."""
        kept = (tuple(asked for asked in case.expected if asked.until <= stop) for case in self.cases)
        cases = tuple(replace(case, expected=asked) for case, asked in zip(self.cases, kept, strict=True))
        return replace(self, timing=replace(self.timing, stop=stop), cases=cases)

    def by_system(self) -> list[Scenario]:
        """Scenarios of the cases that have one system and follow each other, in their order."""
        groups: list[tuple[SystemSpec, list[Case]]] = []
        for case in self.cases:
            system = case.system or self.system
            if not groups or system != groups[-1][0]:
                groups.append((system, []))
            groups[-1][1].append(case)
        return [replace(self, system=system, cases=tuple(cases)) for system, cases in groups]

    @property
    def driven(self) -> tuple[str, ...]:
        """The inputs that stimuli drive, in order of their names."""
        return tuple(sorted(self.stimuli))

    @property
    def recordings(self) -> dict[str, list[Path]]:
        """What it reads files for, besides its parts -> the files."""
        driving = {f"stimulus {name}": one.file for name, one in sorted(self.stimuli.items())}
        compared = dict.fromkeys(file for case in self.cases for expected in case.expected for file in expected.files)
        read = {"parameters": list(self.parameter_sets)} if self.parameter_sets else {}
        read |= {what: [file] for what, file in driving.items() if file is not None}
        return read | ({"reference": list(compared)} if compared else {})

    @property
    def held(self) -> list[str]:
        """What stimuli keep before they begin or after they end, a line each."""
        start, stop = float(self.timing.start), float(self.timing.stop)
        kept = {name: self.stimuli[name].held(start, stop) for name in self.driven}
        return [f"{name} {words}" for name, words in kept.items() if words]

    def recorded(self, outputs: tuple[str, ...]) -> list[str]:
        """What is recorded of a system with these outputs: what the file says, and what is looked at in any case."""
        logged = () if self.logger is None else self.logger.signals.values()
        looked_at = [signal for case in self.cases for signal in case.looked_at]
        return list(dict.fromkeys([*(outputs if self.record is None else self.record), *looked_at, *logged]))


def file_stems(names: Sequence[str]) -> list[str]:
    """A file name for each case, made of its name's letters; distinct also where case is not told apart."""
    stems: list[str] = []
    taken: set[str] = set()
    for name in names:
        plain = re.sub(r"[^\w.-]+", "_", name) or "_"
        numbered = (f"{plain}-{number}" for number in itertools.count(2))
        stem = next(stem for stem in itertools.chain([plain], numbered) if stem.casefold() not in taken)
        taken.add(stem.casefold())
        stems.append(stem)
    return stems
