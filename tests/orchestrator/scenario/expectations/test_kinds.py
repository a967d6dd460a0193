"""Every kind of expectation holds of what it should, fails for a copy that is broken, and says by which figure."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.errors import ScenarioError, TraceError, WiringError
from orchestrator import formats
from orchestrator.scenario.expectations.schema import AGAINST, FIGURES, ExpectationBlock
from orchestrator.trace import FloatArray, Trace
from tests.support.simulation.expecting import asked

TIME = np.linspace(0.0, 10.0, 2001)
DECAY = np.exp(-0.4 * TIME)
STEP = 1.0 - DECAY * (np.cos(3.0 * TIME) + 0.4 / 3.0 * np.sin(3.0 * TIME))  # overshoots by exp(-0.4 pi / 3)
SINE = 2.0 * np.sin(2 * math.pi * TIME)
LAG = 1.0 - np.exp(-TIME)
MODES = np.where(TIME < 3, 1.0, np.where(TIME < 6, 3.0, 2.0))
CLIPPED = np.clip(SINE, -1.0, 1.0)

# kind -> what is asked, of which signal, and a copy of it that is broken.
KINDS: dict[str, tuple[dict[str, Any], FloatArray, FloatArray]] = {
    "below": ({"below": 1.7}, STEP, 1.1 * STEP),
    "above": ({"above": -1e-9}, STEP, STEP - 0.1),
    "near": ({"near": 1.0, "within": 0.03, "after": 9}, STEP, 1.05 * STEP),
    "range": (
        {"range": [{"to": 2, "below": 1.7}, {"to": 4, "below": [1.5, 1.2], "above": [0.5, 0.8]}, {"below": 1.2}]},
        STEP,
        STEP + 0.5 * (np.abs(TIME - 3.8) < 0.1),
    ),
    "final_value": ({"final_value": {"near": 1.0, "within": "2 %", "over": 1}}, STEP, 0.95 * STEP),
    "steady_error": ({"steady_error": {"target": 1.0, "over": 1, "at_most": 0.02}}, STEP, 0.95 * STEP),
    "settling_time": ({"settling_time": {"target": 1, "band": 0.05, "at_most": 8}}, STEP, STEP + 0.1 * (TIME > 9)),
    "rise_time": ({"rise_time": {"target": 1, "at_most": 2.3}}, LAG, 1 - np.exp(-TIME / 1.1)),
    "overshoot": ({"overshoot": {"target": 1, "at_most": "66 %"}}, STEP, 1.02 * STEP),
    "residual_rms": (
        {"residual_rms": {"target": 1, "band": 0.1, "at_most": 0.04}},
        STEP,
        STEP + 0.08 * np.sin(40 * TIME) * (TIME > 5),
    ),
    "peak": ({"peak": {"about": 0.5, "at_most": "1.2 rad"}}, STEP, 1.1 * STEP),
    "monotone": ({"monotone": "rising"}, LAG, LAG - 0.01 * (np.abs(TIME - 5) < 0.01)),
    "rms": ({"rms": {"near": 2 / math.sqrt(2), "within": 0.01}}, SINE, 1.02 * SINE),
    "iae": ({"iae": {"target": 1, "at_most": "1.01 rad.s"}}, LAG, 1 - np.exp(-TIME / 1.1)),
    "ise": ({"ise": {"target": 1, "at_most": 0.51}}, LAG, 1 - np.exp(-TIME / 1.1)),
    "itae": ({"itae": {"target": 1, "at_most": 1.01}}, LAG, 1 - np.exp(-TIME / 1.1)),
    "effort": ({"effort": {"at_most": 20.1}}, SINE, 1.01 * SINE),
    "frequency": ({"frequency": {"near": "1 Hz", "within": "0.01 Hz"}}, SINE, 2 * np.sin(6.4 * TIME)),
    "damping": ({"damping": {"near": 0.4 / math.hypot(0.4, 3), "within": 0.01}}, STEP, np.exp(-0.3 * TIME) * SINE),
    "distortion": (
        {"distortion": {"frequency": "1 Hz", "at_most": 0.01}},
        SINE,
        SINE + 0.05 * np.sin(6 * math.pi * TIME),
    ),
    "limit_cycle": ({"limit_cycle": {"amplitude": {"near": 2, "within": 0.05}}}, SINE, DECAY * SINE),
    "crossings": (
        {"crossings": {"level": 0.5, "direction": "up", "times": [0.08333, 1.08333], "within": "1 ms"}, "before": 2},
        0.5 * SINE,
        np.sin(2 * math.pi * (TIME - 0.005)),
    ),
    "saturations": ({"saturations": {"low": -1, "high": 1, "count": 20}}, CLIPPED, 0.9 * CLIPPED),
    "saturated": ({"saturated": {"low": -1, "high": 1, "at_most": 0.7}}, CLIPPED, np.clip(4 * SINE, -1, 1)),
    "mode_changes": ({"mode_changes": {"modes": [1, 3, 2]}}, MODES, np.where(TIME < 6, MODES, 3.0)),
    "within": ({"within": 0.01}, STEP, STEP + 0.02 * (TIME > 9)),
    "funnel": ({"funnel": {"value": 0.01, "lagging": "20 ms"}}, STEP, np.interp(TIME - 0.04, TIME, STEP)),
    "nrmse": ({"nrmse": {"at_most": "1 %"}}, STEP, 1.03 * STEP),
    "fit": ({"fit": {"at_least": 0.95}}, STEP, 1.05 * STEP),
    "deviation": ({"deviation": {"at_most": 0.01}}, STEP, STEP + 0.02 * (TIME > 9)),
    "lag": ({"lag": {"at_most": "10 ms"}}, STEP, np.interp(TIME - 0.04, TIME, STEP)),
}


def trace(values: FloatArray) -> Trace:
    return Trace(TIME, {"y": values}, {"y": "rad"}, "run")


@pytest.fixture
def ask(tmp_path: Path) -> Callable[[str, FloatArray], Any]:
    def ask(kind: str, values: FloatArray) -> Any:
        fields, good, _ = KINDS[kind]
        if kind in AGAINST:
            formats.write(trace(good), tmp_path / "reference.csv")
            fields = {"reference": {"file": "reference.csv"}, **fields}
        return asked({"signal": "y", **fields}, trace(values), tmp_path)

    return ask


def test_each_kind_of_a_signal_is_in_the_table() -> None:
    assert set(KINDS) == {"near", "below", "above", *FIGURES, *AGAINST} - {"band"}


@pytest.mark.parametrize("kind", KINDS)
def test_a_kind_holds_of_a_good_signal_and_fails_for_a_broken_copy(kind: str, ask: Callable[..., Any]) -> None:
    _, good, broken = KINDS[kind]
    held, failed = ask(kind, good), ask(kind, broken)
    assert held.held, held
    assert not failed.held, failed
    assert held.margin is None or held.margin >= 0
    assert failed.margin is None or failed.margin < 0
    assert not held.doubt and failed.found


@pytest.mark.parametrize("kind", KINDS)
def test_a_sample_that_is_no_number_lets_no_kind_hold(kind: str, ask: Callable[..., Any]) -> None:
    values = KINDS[kind][1].copy()
    values[len(values) // 2 if KINDS[kind][0].get("after") is None else -1] = math.nan
    if KINDS[kind][0].get("before") is not None:
        values[3] = math.nan
    assert not ask(kind, values).held


@pytest.mark.parametrize("kind", KINDS)
def test_a_kind_says_in_words_what_is_asked(kind: str, ask: Callable[..., Any]) -> None:
    text = ask(kind, KINDS[kind][1]).text
    assert text.startswith("y ") and "None" not in text and "=" not in text


@pytest.mark.parametrize(
    ("fields", "found", "unit"),
    [
        ({"settling_time": {"target": 1, "band": 0.05, "at_most": "7400 ms"}}, "settling time 7.449", "s"),
        ({"overshoot": {"target": 1, "at_most": "70 %"}}, "overshoot 0.6578", ""),
        ({"iae": {"target": 1, "at_most": "1000 mrad.s"}}, "IAE 1.597", "rad.s"),
        ({"ise": {"target": 1, "at_most": "10000 deg2.s"}}, "ISE", "rad2.s"),
        ({"peak": {"at_most": "90 deg"}}, "peak 1.658 rad", "rad"),
        ({"frequency": {"at_most": "0.5 Hz"}}, "dominant frequency 3 rad/s", "rad/s"),
    ],
)
def test_figures_have_units_of_their_own_and_bounds_any_that_fit(fields: dict[str, Any], found: str, unit: str) -> None:
    check = asked({"signal": "y", **fields}, trace(STEP))
    assert check.found.startswith(found)
    assert check.unit == unit


@pytest.mark.parametrize(
    ("fields", "held", "margin"),
    [
        ({"peak": {"about": "20 degC", "at_most": "10 degC"}}, True, 1.0),
        ({"peak": {"about": "20 degC", "at_most": "8 degC"}}, False, -1.0),
        ({"rms": {"at_most": "300 degC"}}, True, None),
        ({"final_value": {"near": "29 degC", "within": "1 degC"}}, True, 1.0),
        ({"final_value": {"near": "32 degC", "within": "2 degC"}}, False, -1.0),
        ({"steady_error": {"target": "32 degC", "at_most": "2 degC"}}, False, -1.0),
        ({"settling_time": {"target": "29 degC", "band": "1 degC", "at_most": 9}}, True, None),
        ({"monotone": {"direction": "rising", "slack": "0.1 degC"}}, True, None),
        ({"crossings": {"level": "25 degC", "hysteresis": "1 degC", "count": 1}}, True, None),
        ({"near": "20 degC", "within": "9.5 degC"}, True, 0.5),
    ],
)
def test_distances_do_not_count_from_the_nought_of_a_unit(
    fields: dict[str, Any], held: bool, margin: float | None
) -> None:
    warming = Trace(TIME, {"y": 293.15 + 0.9 * TIME}, {"y": "K"}, "run")
    check = asked({"signal": "y", **fields}, warming)
    assert check.held is held
    assert margin is None or check.margin == pytest.approx(margin)


def test_a_unit_may_begin_with_one() -> None:
    turning = Trace(TIME, {"y": np.full(len(TIME), 2 * math.pi)}, {"y": "rad/s"}, "run")
    assert asked({"signal": "y", "near": "60 1/min", "within": "0.1 1/min"}, turning).held


def test_a_held_signal_is_judged_by_its_steps() -> None:
    coarse = Trace(np.array([0.0, 1.0, 2.0]), {"y": np.array([2.0, 0.0, 0.0])}, {}, "coarse")
    iae = {"signal": "y", "iae": {"at_most": 9}}
    assert asked(iae, coarse).figure == 1.0
    assert asked(iae, coarse, discrete=True).figure == 2.0


def test_several_signals_are_asked_the_same_each(tmp_path: Path) -> None:
    both = Trace(TIME, {"a": STEP, "b": 2 * STEP}, {}, "run")
    formats.write(both, tmp_path / "reference.parquet")
    block = ExpectationBlock(
        signals=["a", "b"], reference={"file": "reference.parquet"}, funnel={"of_range": "1 %"}, after=1, before=9
    )
    one, other = block.expectations(tmp_path)
    assert [str(one), str(other)] == [
        f"{name} stays in a funnel of 0.01 of its range about {name} of reference.parquet after 1 s before 9 s"
        for name in "ab"
    ]


@pytest.mark.parametrize(
    ("fields", "doubt"),
    [
        ({"funnel": {"value": 3}}, "cannot fail for a signal between"),
        ({"funnel": {"value": 0.01, "time": 20}}, "cannot fail for a signal between"),
        ({"within": 3}, "cannot fail for a signal between"),
        ({"nrmse": {"at_least": 0}}, "cannot fail: NRMSE is never below 0"),
        ({"fit": {"at_most": 1}}, "cannot fail: FIT is never below -inf or above 1"),
        ({"fit": {"at_most": 0.9}}, ""),
        ({"funnel": {"value": 0.5}}, ""),
    ],
)
def test_a_tolerance_that_cannot_fail_is_told(fields: dict[str, Any], doubt: str, tmp_path: Path) -> None:
    formats.write(trace(STEP), tmp_path / "reference.csv")
    check = asked({"signal": "y", "reference": {"file": "reference.csv"}, **fields}, trace(STEP), tmp_path)
    assert check.doubt.startswith(doubt) and bool(check.doubt) == bool(doubt)


def test_a_figure_that_is_never_negative_is_doubted_where_nothing_else_is_asked() -> None:
    assert asked({"signal": "y", "rms": {"at_least": 0}}, trace(STEP)).doubt == "cannot fail: rms is never below 0"
    assert not asked({"signal": "y", "rms": {"at_least": 0.1}}, trace(STEP)).doubt


def test_a_constant_reference_is_no_reason_for_doubt(tmp_path: Path) -> None:
    formats.write(trace(np.ones_like(TIME)), tmp_path / "reference.csv")
    fields = {"signal": "y", "reference": {"file": "reference.csv"}, "within": 0.1}
    assert not asked(fields, trace(np.ones_like(TIME)), tmp_path).doubt


@pytest.mark.parametrize("kind", [{"within": 1}, {"funnel": {"value": 1}}, {"fit": {"at_least": 0}}])
@pytest.mark.parametrize(
    ("reference", "error", "problem"),
    [
        (Trace(TIME, {"z": STEP}, {"z": "rad"}), TraceError, "has no signal 'y'"),
        (Trace(TIME, {"y": STEP}, {"y": "kg"}), WiringError, "kg does not fit rad"),
        (Trace(TIME[:100], {"y": STEP[:100]}, {"y": "rad"}), ScenarioError, r"covers 0 to 0\.495 s, not 0 to 10 s"),
        (Trace(TIME, {"y": np.where(TIME == 5, np.nan, STEP)}, {"y": "rad"}), TraceError, "is nan at 5 s"),
    ],
)
def test_a_reference_of_another_signal_unit_or_time_or_without_a_number_is_refused(
    kind: dict[str, Any], reference: Trace, error: type[Exception], problem: str, tmp_path: Path
) -> None:
    formats.write(reference, tmp_path / "reference.parquet")
    fields = {"signal": "y", "reference": {"file": "reference.parquet"}, **kind}
    with pytest.raises(error, match=problem):
        asked(fields, trace(STEP), tmp_path)


def test_a_reference_in_another_unit_or_with_a_factor_is_converted(tmp_path: Path) -> None:
    degrees = Trace(TIME, {"y": np.degrees(STEP), "half": STEP / 2}, {"y": "deg", "half": "rad"})
    formats.write(degrees, tmp_path / "reference.parquet")
    for reference in ({}, {"signal": "half", "factor": 2}):
        fields = {
            "signal": "y",
            "reference": {"file": "reference.parquet", **reference},
            "funnel": {"value": "1e-4 deg"},
        }
        assert asked(fields, trace(STEP), tmp_path).held
    assert not asked({**fields, "funnel": {"value": "1e-4 deg"}}, trace(STEP + 1e-5), tmp_path).held
