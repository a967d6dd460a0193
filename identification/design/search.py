"""The search for experiments: many are drawn, the best are put together, exchanged, and looked around ever nearer.

Information of independent experiments adds up, so that each is simulated once and any set of them costs an addition
(Fedorov 1972, exchange).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import qmc

from fmus.errors import FmuError, IdentificationError, TraceError
from identification.design.bench import DesignBench, Tried, roughly
from identification.design.criteria import figure, unseen
from identification.design.study import DesignStudy, ValueRange
from orchestrator.fmi.interface import Value
from orchestrator.progress import Progress
from orchestrator.trace import FloatArray

HALVINGS = 6  # of an amplitude that a limit is exceeded with
NEAR = 0.15  # of each range, how far a first neighbour lies off; half as far each round
FAINT = 1e-9  # of what all candidates tell, that is taken as known while too few are put together


@dataclass(frozen=True, eq=False)
class TriedExperiment:
    """An experiment that was tried.

    Attributes:
        share: (d,) where its values lie in their family's choices, 0 to 1.
    """

    family: str
    share: FloatArray
    tried: Tried


@dataclass(eq=False)
class FoundExperiments:
    """What a search found.

    Attributes:
        chosen: the experiments.
        candidates: all that keep the limits.
        figures: of the criterion after each round; first that of the drawn ones.
        exceeded: limited variable -> how often an experiment was refused for it, and the value that came nearest.
        failed: reasons of experiments that could not be simulated.
        runs: of the rig.
    """

    chosen: list[TriedExperiment] = field(default_factory=list)
    candidates: list[TriedExperiment] = field(default_factory=list)
    figures: list[float] = field(default_factory=list)
    exceeded: dict[str, tuple[int, float]] = field(default_factory=dict)
    failed: list[str] = field(default_factory=list)
    runs: int = 0


def search(study: DesignStudy, bench: DesignBench, progress: Progress) -> FoundExperiments:
    """The experiments whose intervals are smallest.

    Raises:
        IdentificationError: no experiment keeps the limits, or none of them shows a parameter.
    """
    return _ExperimentSearch(study, bench, progress).found()


class _ExperimentSearch:
    def __init__(self, study: DesignStudy, bench: DesignBench, progress: Progress) -> None:
        self.study, self.bench, self.progress = study, bench, progress
        free = [parameter.name for parameter in study.calibration.parameters.free]
        self.rng = np.random.default_rng(study.search.seed)
        self.result = FoundExperiments()
        self.chosen = [free.index(name) for name in study.parameters]
        self.known = np.zeros((len(free), len(free))) if study.known is None else study.known
        spec = study.search
        self._whole = len(study.families) * spec.candidates + spec.rounds * spec.neighbours * study.count
        self._done = 0

    def found(self) -> FoundExperiments:
        """The result."""
        result = self.result
        for family in self.study.families:
            result.candidates += [made for share in self._drawn(family) if (made := self._try(family, share))]
        if not result.candidates:
            raise self._none()
        result.chosen = self._exchanged(self._put_together())
        result.figures.append(self._figure(result.chosen))
        for number in range(self.study.search.rounds):
            result.chosen = self._exchanged(self._nearer(result.chosen, NEAR / 2**number))
            result.figures.append(self._figure(result.chosen))
        if not math.isfinite(result.figures[-1]):
            raise self._unseen()
        return result

    def _figure(self, candidates: Sequence[TriedExperiment], extra: float = 0.0) -> float:
        whole = self._told(candidates)
        return figure(whole + extra * np.eye(len(whole)), self.study.criterion, self.chosen)

    def _told(self, candidates: Sequence[TriedExperiment]) -> FloatArray:
        return self.known + roughly([one.tried for one in candidates])

    def _drawn(self, family: str) -> FloatArray:
        """(candidates, d) spread evenly."""
        size = len(self.study.space(family))
        sampler = qmc.Halton(max(size, 1), seed=self.rng)
        return np.asarray(sampler.random(self.study.search.candidates if size else 1))[:, :size]

    def _try(self, family: str, share: FloatArray) -> TriedExperiment | None:
        """The experiment, with a smaller amplitude where limits ask for that; None where they refuse it still."""
        self._done += 1
        self.progress(0.9 * min(self._done / self._whole, 1.0), f"{self._done} experiments tried")
        place = [*self.study.space(family)].index(self.study.amplitude) if self.study.amplitude else None
        for reduced in self._reduced(share, place):
            values = self._values(family, reduced)
            try:
                self.result.runs += 1
                whole = self.bench.run(values)
                beyond = self.bench.exceeded(whole)
                if not beyond:
                    return TriedExperiment(family, reduced, self.bench.tried(values, whole))
            except (FmuError, TraceError) as error:
                if len(self.result.failed) < 5:
                    self.result.failed.append(str(error))
                return None
            self._note(beyond)
        return None

    def _reduced(self, share: FloatArray, place: int | None) -> Iterator[FloatArray]:
        """The shares, and then with amplitudes nearer and nearer to the least."""
        yield share
        for number in range(1, HALVINGS + 1) if place is not None else ():
            smaller = share.copy()
            smaller[place] *= 1 - number / HALVINGS
            yield smaller

    def _note(self, beyond: dict[str, float]) -> None:
        for name, value in beyond.items():
            count, nearest = self.result.exceeded.get(name, (0, value))
            self.result.exceeded[name] = count + 1, min(nearest, value, key=self.study.limits[name].beyond)

    def _values(self, family: str, share: FloatArray) -> dict[str, Value]:
        space = self.study.space(family)
        return {name: choice.at(float(one)) for (name, choice), one in zip(space.items(), share, strict=True)}

    def _put_together(self) -> list[TriedExperiment]:
        """One after the other, each the best beside those before it."""
        chosen: list[TriedExperiment] = []
        total = sum(float(np.trace(self._told([one]))) for one in self.result.candidates)
        faint = FAINT * total / len(self.result.candidates)
        for _ in range(self.study.count):
            chosen.append(min(self.result.candidates, key=lambda one: self._figure([*chosen, one], faint)))
        return chosen

    def _exchanged(self, chosen: list[TriedExperiment]) -> list[TriedExperiment]:
        """With any of them exchanged for any other as long as that helps."""
        best = self._figure(chosen)
        for _ in range(10 * len(chosen)):
            tries = [
                [*chosen[:slot], other, *chosen[slot + 1 :]]
                for slot in range(len(chosen))
                for other in self.result.candidates
            ]
            better = min(tries, key=self._figure)
            if not self._figure(better) < best * (1 - 1e-9):
                break
            chosen, best = better, self._figure(better)
        return chosen

    def _nearer(self, chosen: list[TriedExperiment], width: float) -> list[TriedExperiment]:
        """With neighbours in their places, where these are better."""
        for slot in range(len(chosen)):
            for _ in range(self.study.search.neighbours):
                base = chosen[slot]
                made = self._try(base.family, self._beside(base, width))
                if made is None:
                    continue
                self.result.candidates.append(made)
                changed = [*chosen[:slot], made, *chosen[slot + 1 :]]
                if self._figure(changed) < self._figure(chosen):
                    chosen = changed
        return chosen

    def _beside(self, base: TriedExperiment, width: float) -> FloatArray:
        """(d,) shares near those of an experiment; now and then another of some options."""
        choices = [*self.study.space(base.family).values()]
        moved = base.share + width * self.rng.standard_normal(len(choices))
        for place, choice in enumerate(choices):
            if not isinstance(choice, ValueRange):
                again = self.rng.random() < 1 / 3
                moved[place] = self.rng.random() if again else base.share[place]
        return np.clip(moved, 0.0, 1.0)

    def _none(self) -> IdentificationError:
        """No experiment can be had."""
        if self.result.exceeded:
            name, (_, nearest) = max(self.result.exceeded.items(), key=lambda item: item[1][0])
            problem = f"is exceeded in all experiments of the families (by the nearest one with {nearest:.4g})"
            return IdentificationError(f"limits.{name}", problem, "allow smaller amplitudes, or widen it")
        reason = self.result.failed[0] if self.result.failed else "none was drawn"
        return IdentificationError("families", f"no experiment can be simulated and cut: {reason}", "change them")

    def _unseen(self) -> IdentificationError:
        """No set of experiments shows all parameters."""
        free = [parameter.name for parameter in self.study.calibration.parameters.free]
        problem = f"nothing that is allowed shows it apart from the others (experiments: {self.study.count})"
        fix = "allow others by `families`, `vary`, `limits` or `experiments`, or fix it in the calibration's study"
        return IdentificationError(f"parameters.{free[unseen(self._told(self.result.chosen))]}", problem, fix)
