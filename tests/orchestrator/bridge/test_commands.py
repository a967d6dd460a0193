"""The commands that couple: bridge and bench, against each other, too."""

from __future__ import annotations

import json
import re
import signal
import time
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from fmus.errors import TraceError
from orchestrator import formats
from orchestrator.trace import FloatArray
from tests.support.can.coupled import COMMAND, written
from tests.support.can.coupling_samples import ScriptedBus
from tests.support.can.wiring import HANG, command, joined, until_said, wait_for
from tests.support.commands import servotwin

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work

LAW: dict[str, Any] = {
    "title": "Energy control on a bus",
    "components": {"law": {"model": "energy_controller", "parameters": {"gain": 0.02, "sample_time": 0.005}}},
    "run": {"stop": 600, "step": 0.005},
    "can": {
        "database": "rig.dbc",
        "receive": {"law.angle": {"signal": "angle", "safe": 0.5}, "law.speed": {"signal": "speed", "safe": 0}},
        "send": {"voltage": {"source": "law.voltage", "safe": 0}},
        "every": {"Command": 0.005},
        "most_late": 1e4,  # a busy computer is no fault
        "give_up": 1e5,
    },
}
REST = 0.0111  # of the bench [V]; no value that can be received


def test_the_command_judges_and_leaves_a_folder(folder: Path, tmp_path: Path) -> None:
    path = written(folder, expect=[{"signal": "hand.angle", "below": 0.1}])
    arguments = ["can", "bridge", path, "--interface", "virtual", "--channel", "c", "--out", tmp_path / "out", "--json"]
    done = servotwin(*arguments)
    assert done.exit_code == 1
    document = json.loads(done.stdout)
    assert document["can"]["mode"] == "bridge" and not document["passed"]
    assert json.loads((tmp_path / "out" / "manifest.json").read_text()) == document
    assert "rig is on virtual:c" in done.stderr


def test_the_command_keeps_the_result_of_a_bus_that_fails(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bus = ScriptedBus().plug_in(monkeypatch)
    bus.failure = can.CanOperationError("gone")
    arguments = ["can", "bridge", written(folder), "--interface", "virtual", "--channel", "c", "--out", tmp_path / "o"]
    done = servotwin(*arguments)
    assert done.exit_code == 3
    assert "State: no `safe` value for angle" in " ".join(done.stderr.split())  # before anything goes wrong
    assert "(gone); the result up to there is in" in done.stderr
    assert json.loads((tmp_path / "o" / "manifest.json").read_text())["ended"] == "failed"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "bench: has no bus; give --interface and --channel, or --serve"),
        (["--serve", "bus", "--channel", "c"], "--serve: makes a bus of its own; leave out --interface and --channel"),
    ],
)
def test_a_bench_wants_one_bus(folder: Path, arguments: list[str], message: str) -> None:
    done = servotwin("can", "bench", written(folder), *arguments)
    assert done.exit_code == 2
    assert message in done.stderr


def test_ctrl_c_ends_a_bench_with_its_result(folder: Path, tmp_path: Path) -> None:
    with command(
        "can", "bench", written(folder), "--interface", "virtual", "--channel", "c", "--out", tmp_path / "out"
    ) as machine:
        until_said(machine, "rig is on virtual:c")
        time.sleep(0.3)
        machine.send_signal(signal.SIGINT)
        said, complaints = machine.communicate(timeout=HANG)
    assert machine.returncode == 130, said + complaints
    assert re.search(r"interrupted after \d\.\d+ s; the result up to there is in .*\n", complaints)
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert manifest["ended"] == "stopped"
    assert len(formats.read(tmp_path / "out" / "run.parquet").trace) == manifest["can"]["deadlines"]["steps"] + 1


def test_a_bench_and_a_bridge_close_a_loop_over_serial_adapters(folder: Path, tmp_path: Path) -> None:
    rest = {"motor.voltage": {"signal": "Command.voltage", "safe": REST}}
    bench = written(folder, run={"stop": 1, "step": 0.005}, can={"every": {"State": 0.005}, "receive": rest})
    bench = bench.rename(folder / "bench.yaml")
    law = folder / "law.yaml"
    law.write_text(json.dumps(LAW))
    with command("can", "bench", bench, "--serve", tmp_path / "bus", "--out", tmp_path / "bench") as machine:
        wait_for((tmp_path / "bus" / "1").exists)
        with command(
            "can",
            "bridge",
            law,
            "--interface",
            "slcan",
            "--channel",
            tmp_path / "bus" / "1",
            "--bitrate",
            500_000,
            "--out",
            tmp_path / "law",
        ) as controller:
            with joined(tmp_path / "bus" / "2") as peer:
                commands = (one for one in iter(partial(peer.recv, HANG), None) if one.arbitration_id == COMMAND)
                assert len(list(islice(commands, 101))) == 101
            wait_for(lambda: np.count_nonzero(_acted(tmp_path)) >= 20)  # steps, however long all that takes
            controller.send_signal(signal.SIGTERM)
            said, complaints = controller.communicate(timeout=HANG)
            assert controller.returncode == 130, said + complaints
        until_said(machine, "Command is there")
        until_said(machine, "Command: no frame for 0.1 s")
        machine.send_signal(signal.SIGTERM)
        said, complaints = machine.communicate(timeout=HANG)
        assert machine.returncode == 0, said + complaints
    about = {name: json.loads((tmp_path / name / "manifest.json").read_text())["can"] for name in ("bench", "law")}
    sent, steps = about["law"]["sent"], about["law"]["deadlines"]["steps"]
    count = sent["messages"]["Command"]  # late steps are no burst of frames
    assert about["bench"]["received"]["messages"]["Command"] == count == steps + 1 - sent["no_room"] - sent["skipped"]
    assert sent["acknowledged"] and count > 100
    asked = formats.read(tmp_path / "law" / "run.parquet").trace["law.voltage"]
    acted = formats.read(tmp_path / "bench" / "run.parquet").trace["motor.voltage"]
    assert acted[0] == acted[-1] == REST  # while nobody is there, and in silence again
    taken = np.unique(np.round(acted[acted != REST], 3))
    assert taken.any() and np.isin(taken, np.round([*np.clip(asked, -24, 24), 0.0], 3)).all()
    assert not (tmp_path / "bus" / "0").exists()


def _acted(folder: Path) -> FloatArray:
    """The commands on which the bench has acted so far."""
    try:
        acted = [formats.read(record).trace["motor.voltage"] for record in folder.glob(".bench*/0.arrows")]
    except TraceError:  # it holds nothing yet
        return np.empty(0)
    return np.concatenate([np.empty(0), *(one[one != REST] for one in acted)])
