"""Free runs in the tube around a motion: how far a model runs away from recordings that it is driven as."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fmus.errors import ScenarioError
from identification.estimation.parameters import ParameterSet
from identification.motion.motion import Motion
from identification.motion.study import MotionStudy, TubeSpec
from identification.output_error.calibration import Judged, judge
from identification.output_error.study import FreeRunSpec, OutputErrorStudy, StartSpec, TraceSignal, WindowSpec
from identification.output_error.study_checks import ports_of
from identification.output_error.windows import cut_windows
from identification.recordings.campaign import StudyTrace
from orchestrator.assembly.assembly import Assembled, OpenSystem
from orchestrator.trace import FloatArray


@dataclass(frozen=True, eq=False)
class Tube:
    """Recorded windows in the tube, and the free runs of models there.

    Attributes:
        period: of the motion [s].
        judged: name of a model -> its free runs.
    """

    spec: TubeSpec
    period: float
    judged: Mapping[str, Judged]

    def error(self, name: str) -> float:
        """Root mean square error of a model's free runs, all windows together [rad]."""
        return float(np.sqrt(np.mean(np.concatenate([error**2 for error in self._errors(name)]))))

    def errors(self, name: str) -> dict[str, float]:
        """Window -> root mean square error [rad]."""
        windows = [window.name for window in self.judged[name].windows]
        return {w: float(np.sqrt(np.mean(e**2))) for w, e in zip(windows, self._errors(name), strict=True)}

    def improvement(self, name: str) -> float:
        """How many times smaller a model's error is than the generic one's."""
        return self.error("generic") / self.error(name)

    def _errors(self, name: str) -> list[FloatArray]:
        judged = self.judged[name]
        return [y[:, 0] - w.measured[:, 0] for w, y in zip(judged.windows, judged.simulated, strict=True)]


def tube_of(
    study: MotionStudy,
    spec: TubeSpec,
    assembled: Assembled,
    recorded: Sequence[StudyTrace],
    motions: Sequence[Motion],
    models: Mapping[str, Mapping[str, float]],
) -> Tube:
    """Free runs of models, each component.parameter -> value, from recorded start values by the recorded voltage.

    Args:
        assembled: the study's `free_system`.

    Raises:
        InputError: the traces do not last.
        FmuError: a free run fails.
    """
    period = float(np.mean([motion.period for motion in motions]))
    length = study.step * round(spec.periods * period / float(study.step))
    shortest = min(recorded, key=lambda trace: trace.trace.duration).trace
    if shortest.duration < float(length + spec.skip):
        raise ScenarioError(
            "free_runs",
            f"{spec.periods:g} periods of {period:.3g} s after {float(spec.skip):g} s are more than trace "
            f"{shortest.name} lasts ({shortest.duration:.3g} s)",
            "ask for fewer, skip less, or record longer",
        )
    every = WindowSpec(length, skip=spec.skip)
    asked = _asked(study, every)
    with OpenSystem(assembled) as opened:
        ports = ports_of(asked, opened.system)
    windows = cut_windows(asked.run, recorded, every, ports)
    return Tube(spec, period, {name: judge(asked, assembled, windows, values) for name, values in models.items()})


def _asked(study: MotionStudy, windows: WindowSpec) -> OutputErrorStudy:
    """The free runs as output error knows them, with nothing to be fitted."""
    signals = study.signals
    assert signals.voltage is not None and signals.input is not None
    speed = StartSpec(signals.angle, derivative=1) if signals.speed is None else StartSpec(signals.speed)
    run = FreeRunSpec(
        study.step,
        {signals.output: TraceSignal(signals.angle)},
        {signals.input: TraceSignal(signals.voltage)},
        {signals.angle_start: StartSpec(signals.angle), signals.speed_start: speed},
    )
    return OutputErrorStudy(
        study.title, study.free_system, study.traces, run, windows, windows, ParameterSet(()), weight="none"
    )
