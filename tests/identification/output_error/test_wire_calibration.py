"""Studies of CAN logs: commands held, readings interpolated, losses told, and the truth found all the same."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.errors import DatabaseError, TraceError
from identification.calibrate import calibrate_study, layout_of
from identification.output_error.schema import OutputErrorBlock
from identification.output_error.windows import cut_windows
from identification.recordings.campaign import load_campaign, recording_warnings
from identification.validation import validate_result
from orchestrator.can import logs
from orchestrator.can.codec.encoding import Encoder
from orchestrator.can.database.database import load
from orchestrator.trace import FloatArray, Trace
from tests.support.can.butterfly_logs import DATABASE, START, on_a_real_bus, write_logs
from tests.support.identification.small_study import RECORDINGS, TRUTH, simulated, study, write_study

pytestmark = pytest.mark.usefixtures("in_this_process")

SCENARIOS = DATABASE.parent
LAYOUT = {"database": "rig.dbc", "columns": {"voltage": "Command.voltage", "angle": "State.angle"}}
CYCLE, COUNT = 0.01, 601  # [s], frames of a message in a recording


def sweep(number: int) -> FloatArray:
    """(K,) a swept sine, another one for each recording [V]."""
    time = CYCLE * np.arange(COUNT)
    return np.asarray(0.003 * np.cos(2 * math.pi * (0.5 + 0.3 * number + 0.1 * time) * time + number))


def rig(folder: Path) -> Path:
    """The folder with the Butterfly's database at a cycle of 10 ms, and a log of each recording of the small study."""
    database = folder / "rig.dbc"
    database.write_text(DATABASE.read_text().replace(" 5;", " 10;"))
    for number, (name, mass) in enumerate(RECORDINGS.items()):
        rng, driven = np.random.default_rng([3, number]), sweep(number)
        angle = simulated(driven, mass) + rng.normal(0, 5e-4, COUNT)
        trace = Trace(CYCLE * np.arange(COUNT), {"voltage": driven, "angle": angle})
        frames = Encoder(load(database), ["voltage", "angle"]).encode(trace, START)
        logs.write(folder / f"{name}.blf", [on_a_real_bus(frames, rng)])
    return folder


def wire_study(path: Path, **changes: Any) -> Path:
    """The small study of these logs, each window's start estimated."""
    near = {"signal": "angle", "half_width": 0.05, "estimated": True}
    plain = {
        "traces": study()["traces"] | {"files": "rig_*.blf", "layout": LAYOUT},
        "initial": {"hand.angle_start": near, "hand.speed_start": near | {"derivative": 1}},
        "windows": {"length": 0.9},
        "validation": {"length": 0.9},
    }
    return write_study(path, **plain | changes)


def still(fraction: float, remark: str) -> None:
    """No progress is shown."""


@pytest.fixture(scope="module")
def wired(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return rig(tmp_path_factory.mktemp("wire"))


@pytest.fixture(scope="module")
def result(wired: Path) -> Path:
    calibrate_study(wire_study(wired / "study.yaml"), None, wired / "out", still)
    return wired / "out"


def summary(folder: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    return document


def test_parameters_are_found_from_logs_with_jitter_and_losses(result: Path) -> None:
    for name, entry in summary(result)["parameters"].items():
        assert entry["value"] == pytest.approx(TRUTH[name], rel=0.01), name
        assert entry["start"] != pytest.approx(TRUTH[name], rel=0.2), name
    assert summary(result)["fit"]["validation"]["median"] > 0.99


def test_what_the_bus_lost_is_a_warning_with_details_beside_the_recordings(result: Path) -> None:
    document = summary(result)
    noted = {each["trace"]: each["notes"] for each in document["data"] if "notes" in each}
    assert noted and all("frames missing (estimated)" in notes[0] for notes in noted.values())
    (warning,) = [each for each in document["warnings"] if "recordings is to be known" in each]
    assert warning.startswith(f"what was seen in {len(noted)} of 3 recordings") and next(iter(noted)) in warning


def test_a_result_is_validated_with_the_database_that_it_keeps(result: Path, wired: Path, tmp_path: Path) -> None:
    moved = shutil.copytree(result, tmp_path / "elsewhere")
    data = tmp_path / "data"
    data.mkdir()
    for log in wired.glob("*.blf"):
        shutil.copy(log, data)
    assert (moved / "rig.dbc").read_bytes() == (wired / "rig.dbc").read_bytes()
    judged = validate_result(moved, data, tmp_path / "judged", still)
    fit = summary(result)["fit"]
    assert judged["fit"]["unseen"]["median"] == pytest.approx(fit["validation"]["median"], abs=1e-6)
    assert judged["fit"]["fitted"]["median"] == pytest.approx(fit["train"]["median"], abs=1e-6)


def test_a_database_from_another_folder_is_kept_by_its_name(wired: Path, tmp_path: Path) -> None:
    known = {name: {"start": value, "fixed": name != "hand.inertia"} for name, value in TRUTH.items()}
    (tmp_path / "buses").mkdir()
    shutil.copy(wired / "rig.dbc", tmp_path / "buses" / "rig.dbc")
    traces = study()["traces"] | {"files": "rig_*.blf", "layout": LAYOUT | {"database": "../buses/rig.dbc"}}
    study_file = wire_study(tmp_path / "studies" / "study.yaml", traces=traces, parameters=known)
    calibrate_study(study_file, wired, tmp_path / "out", still)
    (tmp_path / "buses").rename(tmp_path / "gone")
    assert layout_of(tmp_path / "out" / "study.yaml").database == tmp_path / "out" / "rig.dbc"
    validate_result(tmp_path / "out", wired, tmp_path / "judged", still)


def block(**changes: Any) -> OutputErrorBlock:
    traces = {"files": "*.blf", "layout": LAYOUT} | changes
    return OutputErrorBlock.model_validate(study(traces=traces, windows={"length": 0.04}))


def two_messages(folder: Path) -> Path:
    """A log of commands every 10 ms and of states in the middle between them."""
    folder.mkdir(exist_ok=True)
    shutil.copy(DATABASE, folder / "rig.dbc")
    database, time = load(folder / "rig.dbc"), 0.01 * np.arange(8)
    command = Encoder(database, ["voltage"]).encode(Trace(time, {"voltage": 0.01 * np.arange(8)}), START)
    state = Encoder(database, ["angle"]).encode(Trace(time + 0.005, {"angle": 0.05 * np.arange(8) ** 2}), START)
    rows = np.arange(0, len(command), 2), np.arange(0, len(state), 2)
    logs.write(folder / "run.blf", [command[rows[0]], state[rows[1]]])
    return folder


def test_commands_keep_their_value_and_readings_run_from_frame_to_frame(tmp_path: Path) -> None:
    study_block = block()
    (run,) = load_campaign(study_block.source(two_messages(tmp_path)))
    assert run.held and set(run.trace.names) == {"voltage", "angle"}
    time = run.trace.time
    np.testing.assert_allclose(time, 0.005 * np.arange(1, len(time) + 1), atol=1e-6)
    np.testing.assert_allclose(run.trace["voltage"], 0.01 * np.floor(time / 0.01 + 1e-3), atol=1e-9)
    states = 0.005 + 0.01 * np.arange(8)
    np.testing.assert_allclose(run.trace["angle"], np.interp(time, states, 0.05 * np.arange(8) ** 2), atol=1e-4)


def test_commands_of_a_log_count_by_their_means(tmp_path: Path) -> None:
    """The stairs of 10 ms over steps of 4 ms."""
    changes = study(traces={"files": "*.blf", "layout": LAYOUT}, windows={"length": 0.04}, step=0.004)
    study_block = OutputErrorBlock.model_validate(changes)
    campaign = load_campaign(study_block.source(two_messages(tmp_path)))
    asked = study_block.study(study_block.system(tmp_path), study_block.source(tmp_path))
    (cut,) = cut_windows(asked.run, campaign, asked.windows)
    assert cut.start == pytest.approx(0.008)
    np.testing.assert_allclose(cut.stimuli["motor.voltage"][:5], [0.005, 0.01, 0.01, 0.02, 0.02], atol=1e-5)


def test_without_columns_the_studys_signals_are_the_databases(tmp_path: Path) -> None:
    changes = {"inputs": {"motor.voltage": {"signal": "voltage"}}, "outputs": {"hand.angle": {"signal": "State.angle"}}}
    study_block = OutputErrorBlock.model_validate(
        study(traces={"files": "*.blf", "layout": {"database": "rig.dbc"}}, windows={"length": 0.04}, **changes)
    )
    (run,) = load_campaign(study_block.source(two_messages(tmp_path)))
    assert set(run.trace.names) == {"voltage", "State.angle"}


def test_a_signal_that_the_database_lacks_is_refused_with_its_name(tmp_path: Path) -> None:
    study_block = block(layout=LAYOUT | {"columns": {"voltage": "Command.volts", "angle": "State.angle"}})
    with pytest.raises(DatabaseError, match=r"rig\.dbc.*volts"):
        load_campaign(study_block.source(two_messages(tmp_path)))


def test_logs_without_a_database_are_refused_with_the_key_to_write(tmp_path: Path) -> None:
    study_block = block(layout={})
    with pytest.raises(TraceError, match=r"holds raw CAN frames; .* traces\.layout\.database"):
        load_campaign(study_block.source(two_messages(tmp_path)))


def test_what_is_left_of_a_damaged_log_is_taken_and_the_damage_noted(wired: Path, tmp_path: Path) -> None:
    whole = (wired / "rig_0__a.blf").read_bytes()
    (tmp_path / "run.blf").write_bytes(whole[: len(whole) - 700])
    shutil.copy(wired / "rig.dbc", tmp_path)
    study_block = block()
    (run,) = load_campaign(study_block.source(tmp_path))
    assert any("byte" in note for note in run.notes), run.notes
    assert 1 < run.trace.duration < 6
    (warning,) = recording_warnings([run])
    assert "byte" in warning


@pytest.mark.slow
def test_the_real_robots_logs_fit_as_well_as_its_recordings(butterfly_data: Path, tmp_path: Path) -> None:
    """Median FIT of what was kept aside within 0.005 of that from the raw files."""
    write_logs(butterfly_data, tmp_path / "logs")
    raw = calibrate_study(SCENARIOS / "calibration.yaml", butterfly_data, tmp_path / "raw", still)
    wire = calibrate_study(SCENARIOS / "calibration_can.yaml", tmp_path / "logs", tmp_path / "wire", still)
    assert raw["fit"]["validation"]["windows"] == wire["fit"]["validation"]["windows"]
    assert wire["fit"]["validation"]["median"] == pytest.approx(raw["fit"]["validation"]["median"], abs=0.005)
    low, high = wire["parameters"]["command_delay"]["ci95"]
    assert low < 0 < high
    for name, entry in raw["parameters"].items():
        if name != "motor.inductance":  # there a step of 5 ms holds the command for as long
            other = wire["parameters"][name]["ci95"]
            assert entry["ci95"][0] <= other[1] and other[0] <= entry["ci95"][1], name
