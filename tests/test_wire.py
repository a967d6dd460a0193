"""The project end to end over real serial lines: rigs, recorders and controllers as processes, then calibration."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator import formats
from orchestrator.batch.procedure import run_procedure
from orchestrator.progress import READY
from tests.support.tools.own_processes import children

SCENARIOS = Path(__file__).parents[1] / "scenarios"


def assert_near_the_truth(summary: dict[str, Any]) -> None:
    """How far off the estimates are in halves of their 95 % intervals: by root mean square, and the worst of them.

    Errors as the intervals have them exceed an rms of 1 once in 3,000 times; the rest is room for late deadlines.
    """
    found = [entry for entry in summary["parameters"].values() if entry.get("truth") is not None]
    off = [2 * abs(entry["value"] - entry["truth"]) / (entry["ci95"][1] - entry["ci95"][0]) for entry in found]
    assert len(off) == 7
    assert np.sqrt(np.mean(np.square(off))) < 1.5, off
    assert max(off) < 3, off


@pytest.mark.slow
@pytest.mark.shipped
def test_what_is_recorded_on_the_bus_calibrates_the_rig_behind_it(tmp_path: Path) -> None:
    done = run_procedure(SCENARIOS / "butterfly" / "bus" / "procedure.yaml", tmp_path / "out")
    assert [case["error"] for case in done["cases"] if not case["passed"]] == []
    summary = json.loads((tmp_path / "out" / "calibrated" / "summary.json").read_text())
    assert_near_the_truth(summary)
    assert json.loads((tmp_path / "out" / "calibrated" / "validation" / "summary.json").read_text())["held"]


@pytest.mark.slow
def test_an_arm_in_one_process_follows_a_controller_in_another(tmp_path: Path) -> None:
    """Whatever the load, no frame is lost and the arm is left without voltage; it follows a loop that is in time."""
    done = run_procedure(SCENARIOS / "flexible_arm" / "bus" / "procedure.yaml", tmp_path / "out")
    manifest = json.loads((tmp_path / "out" / "controller" / "manifest.json").read_text())
    bus = manifest["can"]
    assert bus["received"]["frames"] > 1000 and bus["received"]["dropped"] == bus["loss_count"] == 0
    torque = formats.read(tmp_path / "out" / "rig" / "run.parquet").trace["drive.torque"]
    assert np.any(torque) and torque[-1] == 0
    if bus["deadlines"]["on_time"] > 0.98:
        assert [case["error"] for case in done["cases"] if not case["passed"]] == []
        assert manifest["passed"]


BUS = SCENARIOS / "butterfly" / "motion" / "bus"


@pytest.mark.slow
@pytest.mark.shipped
def test_energy_control_from_another_process_comes_to_the_orbit_from_inside_and_outside(tmp_path: Path) -> None:
    done = run_procedure(BUS / "procedure.yaml", tmp_path / "out")
    assert [case["error"] for case in done["cases"] if not case["passed"]] == []
    for side, sign in (("inside", -1), ("outside", 1)):
        energy = formats.read(tmp_path / "out" / "driven" / side / "run.parquet").trace["controller.energy"]
        assert max(sign * (energy[200:400] - 0.0728)) > 0, "it begins on its own side of the orbit"


@contextmanager
def command(ready: Path, *words: object) -> Iterator[subprocess.Popen[bytes]]:
    """A command that is on its bus, in a group of processes of its own; all gone in the end."""
    started = [str(Path(sys.executable).parent / "servotwin"), *map(str, words)]
    environment = os.environ | {READY: str(ready)}
    with subprocess.Popen(started, start_new_session=True, stdout=subprocess.DEVNULL, env=environment) as process:
        try:
            awaited(ready)
            yield process
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)


def awaited(path: Path, limit: float = 240.0) -> None:
    until = time.monotonic() + limit
    while not path.exists():
        assert time.monotonic() < until, f"{path} has not come"
        time.sleep(0.05)


@pytest.mark.slow
@pytest.mark.shipped
def test_when_the_energy_controller_is_killed_the_hand_is_left_without_voltage_and_only_loses_energy(
    tmp_path: Path,
) -> None:
    """The steps and the process that has their bus are killed at once, so that nobody can send a safe value."""
    bus, bench = tmp_path / "bus", tmp_path / "bench"
    served = ("--serve", bus, "--ports", 2, "--out", bench)
    with command(tmp_path / "rig", "can", "bench", BUS / "rig.yaml", *served) as rig:
        wired = ("--interface", "slcan", "--channel", bus / "1", "--bitrate", 500000, "--duration", 600)
        with command(tmp_path / "controller", "can", "bridge", BUS / "controller.yaml", *wired) as controller:
            time.sleep(5)
            (steps,) = children(controller.pid)
            os.killpg(steps, signal.SIGKILL)
            assert controller.wait() == 3
        time.sleep(5)
        rig.send_signal(signal.SIGTERM)
        assert rig.wait(60) == 0
    trace = formats.read(bench / "run.parquet").trace
    driven = np.flatnonzero(trace["motor.voltage"])
    assert len(driven) > 100, "the controller has never driven it"
    after = trace.between(trace.time[driven[-1]] + 0.02, trace.time[-1])
    assert after.duration > 2
    assert not after["motor.voltage"].any()
    assert np.all(np.diff(after["hand.energy"]) < 1e-7)
