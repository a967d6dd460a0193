"""Windows that recordings choose: how long they are, and which of those that would fit are taken."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from fmus.errors import TraceError
from identification.output_error.free_runs.window import FreeRunWindow
from identification.output_error.study import AutoWindows, FreeRunSpec, OutputErrorStudy, WindowSpec
from identification.output_error.times.spans import on_raster
from identification.output_error.windows import cut_windows
from identification.recordings.campaign import StudyTrace
from identification.signals.excitation import STILL, Length, Picked, most_moving, motion, spreads, stretch_length
from orchestrator.fmi.interface import Port


@dataclass(frozen=True)
class PickedWindows:
    """How recordings have chosen windows: their length, and by trace what became of those that would fit."""

    length: Length
    traces: Mapping[str, Picked]


def chosen_length(study: OutputErrorStudy, fitted: Sequence[StudyTrace]) -> Length | None:
    """How long windows are that recordings choose, by those that are fitted; None where the study says it.

    Raises:
        TraceError: a signal is missing.
    """
    asked = [spec for spec in (study.windows, study.validation) if isinstance(spec, AutoWindows)]
    if not asked:
        return None
    traces = [replace(one.trace, name=one.place).select(study.run.concerned) for one in fitted]
    skips = [on_raster(spec.skip, trace.interval, study.run.step) for spec in asked for trace in traces]
    return stretch_length(traces, study.run.compared, study.run.step, max(skips))


def picked_windows(
    run: FreeRunSpec,
    traces: Sequence[StudyTrace],
    windows: WindowSpec | AutoWindows,
    length: Length | None,
    ports: Mapping[str, Port] | None = None,
) -> tuple[list[FreeRunWindow], dict[str, Picked]]:
    """The windows of these traces; of those that recordings choose the ones that move, and by trace what became of all.

    Raises:
        TraceError: nothing moves in any; or as `cut_windows`.
    """
    if isinstance(windows, WindowSpec):
        return cut_windows(run, traces, windows, ports), {}
    assert length is not None
    cut = cut_windows(run, traces, windows.of(length.seconds), ports)
    kept, picked = list[FreeRunWindow](), dict[str, Picked]()
    spread = spreads((one.trace for one in traces), run.concerned) if traces else {}
    for one in traces:
        own = [window for window in cut if window.trace == one.trace.name]
        moved = [motion(one.trace, window.start, window.start + float(window.stop), spread) for window in own]
        moves = [max(signals[name] for name in run.compared) >= STILL for signals in moved]
        taken, picked[one.trace.name] = most_moving([sum(one.values()) for one in moved], moves, windows.most)
        kept += [own[number] for number in taken]
    if cut and not kept:
        raise TraceError(traces[0].place, "moves in no window", "give `windows.length`, or a recording that moves")
    return kept, picked
