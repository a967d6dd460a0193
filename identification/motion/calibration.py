"""A recalibration near a motion, from its study to a model and how it runs beside the generic one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fmus.errors import IdentificationError, TraceError, WiringError
from identification.built_system import BuiltSystem
from identification.motion.balance import UNITS, Balance, Lumped, Values, energy_balance
from identification.motion.found import Orbit, Recalibrated, as_published, by_balance, by_invariant
from identification.motion.motion import Motion, recorded_motion
from identification.motion.stretches import PERIODS
from identification.motion.study import MotionStudy, Way
from identification.motion.tube import Tube, tube_of
from identification.quantities import must_be_in, number
from identification.recordings.campaign import StudyTrace, load_campaign, recording_warnings
from identification.recordings.marks import nothing_left, pieces, require_known
from identification.recordings.units import in_units
from orchestrator.assembly.assembly import OpenSystem
from orchestrator.crossing import named
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress, share_of, silent
from orchestrator.settable import check_values
from orchestrator.system import System, must_be, recordable

APART = 2e-6  # of p3, by which an energy has to differ from an equilibrium's (Lemma 8)


@dataclass(frozen=True, eq=False)
class MotionCalibration:
    """What a study gave.

    Attributes:
        system: the FMUs as they were before.
        generic: lumped parameter -> value before [UNITS].
        found: way -> what it gave; refused: way -> why it gave nothing.
        balance: the details of the energy balance, where there is one.
        orbit: what the controller was set to, where the study names it.
        tube: free runs in the tube around the motion, where the study asks for them.
        still: pieces of recordings, between what is marked, that are too short to swing and are left out.
    """

    study: MotionStudy
    system: BuiltSystem
    recorded: tuple[StudyTrace, ...]
    motions: tuple[Motion, ...]
    generic: Values
    found: Mapping[Way, Recalibrated]
    refused: Mapping[str, str]
    balance: Balance | None
    orbit: Orbit | None
    tube: Tube | None
    still: int = 0

    @property
    def taken(self) -> Recalibrated:
        """What is written."""
        return self.found[self.study.take]

    @property
    def written(self) -> dict[str, Lumped]:
        """component.parameter -> lumped parameter, of all that are written."""
        return {
            target: name
            for name, targets in self.study.write.items()
            for target in targets
            if name in self.taken.parameters
        }

    @property
    def off_orbit(self) -> float | None:
        """How far the motions' last amplitude is off the wanted one, over that; None where no controller is named."""
        if self.orbit is None:
            return None
        return float(np.mean([motion.amplitude for motion in self.motions])) / self.orbit.amplitude - 1

    @property
    def warnings(self) -> list[str]:
        """What a reader of the figures must know."""
        reasons = dict.fromkeys(self.refused.values())
        unseen = [f"{', '.join(w for w, why in self.refused.items() if why == reason)}: {reason}" for reason in reasons]
        if self.still:
            unseen.append(f"{self.still} pieces of recordings last less than {PERIODS:g} periods and are left out")
        return [*self.taken.remarks, *unseen, *recording_warnings(self.recorded)]


def calibrate(
    study: MotionStudy, data: Path | None = None, progress: Progress = silent, isolation: Isolation | None = None
) -> MotionCalibration:
    """Recalibrate the study's model near the motion of its traces, and run it beside the generic one.

    Args:
        data: the recordings, over the study's own.
        isolation: of FMUs whose runs are the recordings.

    Raises:
        InputError: the study, its system and its traces do not fit together, or the motion does not tell.
        FmuError: the FMUs fail.
    """
    system = BuiltSystem(study.system)
    with OpenSystem(system.assembled) as opened:
        generic, equilibrium, orbit = _checked(study, opened.system)
    loaded = load_campaign(study.traces, data, share_of(progress, 0.0, 0.5), isolation)
    recorded = in_units(loaded, {signal: named(unit) for signal, unit in study.signals.units.items()})
    pieces_of = [_motions(study, trace, equilibrium) for trace in recorded]
    motions = tuple(motion for swinging, _ in pieces_of for motion in swinging)
    still = sum(short for _, short in pieces_of)
    progress(0.6, "balance of energy")
    balance = energy_balance(motions, generic, study.held, study.dry_friction) if study.signals.voltage else None
    found, refused = _ways(study, motions, balance, orbit)
    tube = None
    if study.tube is not None:
        progress(0.7, "free runs")
        models = _models(study, generic, found)
        free = BuiltSystem(study.free_system, [study.signals.input] if study.signals.input else [])
        tube = tube_of(study, study.tube, free.assembled, recorded, motions, models)
    return MotionCalibration(
        study, system, tuple(recorded), motions, generic, found, refused, balance, orbit, tube, still
    )


def _motions(study: MotionStudy, recorded: StudyTrace, equilibrium: float) -> tuple[list[Motion], int]:
    """What is left of a trace between its marks, each piece that swings a motion; and how many do not, or hardly.

    Raises:
        TraceError: a signal is missing or constant, or marks leave nothing.
        IdentificationError: no piece swings.
    """
    signals, swinging, why = study.signals, list[Motion](), ""
    kept = pieces(recorded.trace.select(list(signals.units)), recorded.marks)
    if not kept:
        raise nothing_left(recorded.place, "no motion is", recorded.marks)
    require_known(recorded.excluded_as, kept, signals.units)
    for piece in kept:
        try:
            motion = recorded_motion(piece, signals.angle, signals.speed, equilibrium, signals.voltage)
            if motion.time[-1] - motion.time[0] >= PERIODS * motion.period:
                swinging.append(motion)
            else:
                why = f"lasts less than {PERIODS:g} periods"
        except (IdentificationError, TraceError) as error:
            why = error.problem
    if not swinging:
        raise IdentificationError(recorded.place, why, "record an oscillation of some periods, without gaps")
    return swinging, len(kept) - len(swinging)


def _ways(
    study: MotionStudy, motions: Sequence[Motion], balance: Balance | None, orbit: Orbit | None
) -> tuple[dict[Way, Recalibrated], dict[str, str]]:
    """All ways that can be gone.

    Raises:
        IdentificationError: the one that is taken cannot.
    """
    found: dict[Way, Recalibrated] = {}
    refused: dict[str, str] = {}
    if balance is not None:
        found["balance"] = by_balance(balance, study.held)
    if orbit is not None:
        ways: dict[Way, Callable[[Sequence[Motion], Orbit], Recalibrated]] = {
            "invariant": by_invariant,
            "published": as_published,
        }
        for way, go in ways.items():
            try:
                found[way] = go(motions, orbit)
            except IdentificationError as error:
                if way == study.take:
                    raise
                refused[way] = str(error)
    return found, refused


def _models(study: MotionStudy, generic: Values, found: Mapping[Way, Recalibrated]) -> dict[str, dict[str, float]]:
    """Name of a model -> component.parameter -> value: the generic one, and one a way."""
    before = {target: generic[name] for name, targets in study.write.items() for target in targets}
    models = {"generic": before}
    for way, one in found.items():
        values = one.values
        models[way] = before | {t: values[n] for n, targets in study.write.items() if n in values for t in targets}
    return models


def _checked(study: MotionStudy, system: System) -> tuple[Values, float, Orbit | None]:
    """Generic values, the equilibrium angle and the controller's orbit, once all of the study is seen to exist.

    Raises:
        WiringError: a name of the study is not there, or in another unit, or its generic values disagree.
        IdentificationError: the controller asks for an energy that Lemma 8 excludes.
    """
    values, signals = study.system.values(), study.signals
    check_values(system, values)
    recordable(system, signals.output, "angle.output")
    if signals.input is not None:
        must_be(system, signals.input, "input", "voltage")
    starts = [signals.angle_start, signals.speed_start]
    written = {name: [*targets] for name, targets in study.write.items()}
    for key, names in (("angle, speed", starts), ("equilibrium", [study.equilibrium]), ("truth", [*study.truth])):
        for name in names:
            must_be(system, name, "parameter", key)
    generic = {lumped: _generic(system, values, lumped, names) for lumped, names in written.items()}
    for lumped, value in generic.items():
        if lumped in ("p1", "p3", "p4") and not value > 0:
            raise WiringError(
                f"write.{lumped}", f"the generic value is {value:g}", "give the generic model a positive one"
            )
    return generic, number(system, values, study.equilibrium), _orbit(study, system, values)


def _generic(system: System, values: Mapping[str, object], lumped: Lumped, names: Sequence[str]) -> float:
    """The value that all of these have."""
    key = f"write.{lumped}"
    for name in names:
        must_be(system, name, "parameter", key)
        must_be_in(system, key, name, lumped, UNITS[lumped])
    first, *others = ((name, number(system, values, name)) for name in names)
    for name, value in others:
        if not np.isclose(value, first[1], rtol=1e-9, atol=0):
            raise WiringError(
                f"{key}.{name}", f"is {value:g} where {first[0]} is {first[1]:g}", "give both the generic value"
            )
    return first[1]


def _orbit(study: MotionStudy, system: System, values: Mapping[str, object]) -> Orbit | None:
    """What the controller is set to."""
    if study.controller is None:
        return None
    names: tuple[Lumped, ...] = ("p1", "p2", "p3", "p4")
    model = {name: number(system, values, f"{study.controller}.{name}") for name in names}
    amplitude = number(system, values, f"{study.controller}.amplitude")
    target = model["p3"] * (1 - float(np.cos(amplitude)))
    for energy, which in ((0.0, "downward"), (2 * model["p3"], "upright")):
        if abs(target - energy) <= APART * model["p3"]:
            raise IdentificationError(
                f"{study.controller}.amplitude",
                f"{amplitude:g} rad asks for the {which} equilibrium's energy, {energy:g} J, which Lemma 8 excludes",
                "ask for an oscillation between 0 and pi rad",
            )
    return Orbit(model, number(system, values, f"{study.controller}.gain"), amplitude, target)
