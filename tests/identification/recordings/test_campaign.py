"""Recordings of a campaign: found, read and named; what is wrong with one is one line, and nothing is written."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from fmus.errors import ScenarioError, TraceError
from fmus.files import sha256
from identification.output_error import calibration
from identification.recordings.campaign import TraceSource, load_campaign, recording_warnings, split
from identification.recordings.schema import TracesBlock, UsedSignals
from tests.support.commands import servotwin
from tests.support.identification.small_study import COUNT, STEP, record, simulated, study, voltage, write_study

LAYOUT = {"variable": "D", "time": 0, "columns": {"voltage": 1, "angle": 2}, "units": {"voltage": "V", "angle": "rad"}}
NAME = {
    "pattern": r"rig_(?P<mass>\d+(_\d+)?)__(?P<run>\w+)",
    "fields": {"mass": {"decimal": "underscore", "factor": 0.001}},
}
TRACES = {"files": "rig_*.mat", "layout": LAYOUT, "file_name": NAME, "values": {"hand.added_mass": "mass"}}


def columns(added_mass: float = 0.0, seed: int = 0) -> np.ndarray:
    """Time, voltage and angle as a recording has them."""
    driven = voltage(seed)
    return np.column_stack([np.arange(COUNT) * STEP, driven, simulated(driven, added_mass)])


def save(folder: Path, name: str, matrix: np.ndarray, variable: str = "D") -> Path:
    folder.mkdir(exist_ok=True)
    savemat(folder / f"{name}.mat", {variable: matrix})
    return folder / f"{name}.mat"


def traces(folder: Path, **changes: Any) -> TraceSource:
    return TracesBlock.model_validate(TRACES | changes).source(folder, UsedSignals())


def test_recordings_come_by_name_with_what_their_names_and_bytes_tell(tmp_path: Path) -> None:
    for name in ("rig_50__b", "rig_120_5__a"):
        save(tmp_path, name, columns())
    (tmp_path / "notes.txt").write_text("not a recording")
    one, other = load_campaign(traces(tmp_path))
    assert (one.trace.name, one.fields) == ("rig_120_5__a", {"mass": 0.1205})
    assert (other.trace.name, other.fields) == ("rig_50__b", {"mass": 0.05})
    assert one.sha256 == sha256(tmp_path / "rig_120_5__a.mat")
    assert one.trace.units == {"voltage": "V", "angle": "rad"}
    np.testing.assert_array_equal(other.trace["angle"], columns()[:, 2])


def test_files_that_hold_the_same_recording_are_named_whatever_their_names(tmp_path: Path) -> None:
    """Parts and cases have their source in common, and are not."""
    save(tmp_path, "rig_0__b", columns(seed=1))
    shutil.copy(save(tmp_path, "rig_0__a", columns()), tmp_path / "rig_0__c.mat")
    found = load_campaign(traces(tmp_path))
    assert [one for one in recording_warnings(found) if "same recording" in one] == [
        "rig_0__a and rig_0__c are the same recording: fitted twice it makes intervals narrower than they are, and "
        "kept aside it judges nothing; remove all but one"
    ]
    assert recording_warnings([found[0], found[1], found[0]]) == []


def test_the_folder_of_data_goes_over_that_of_the_study_and_a_file_stands_for_itself(tmp_path: Path) -> None:
    save(tmp_path, "rig_0__a", columns())
    there = save(tmp_path / "data", "rig_1__b", columns())
    save(tmp_path / "data", "rig_2__c", columns())
    names = [
        [each.trace.name for each in load_campaign(traces(tmp_path), data)] for data in (None, tmp_path / "data", there)
    ]
    assert names == [["rig_0__a"], ["rig_1__b", "rig_2__c"], ["rig_1__b"]]


def test_stamps_out_of_order_are_put_in_order_and_told(tmp_path: Path) -> None:
    save(tmp_path, "rig_0__a", columns())
    save(tmp_path, "rig_0__b", columns()[np.r_[0:10, 9, 11, 10, 12:COUNT]])
    recorded = load_campaign(traces(tmp_path))
    (warning,) = recording_warnings(recorded)
    assert "1 recordings" in warning and "rig_0__b" in warning and "1 repeated" in warning
    assert recording_warnings(recorded[:1]) == []


def test_holding_out_splits_by_name(tmp_path: Path) -> None:
    for name in ("rig_0__a", "rig_0__b", "rig_0__c"):
        save(tmp_path, name, columns())
    recorded = load_campaign(traces(tmp_path))
    fitted, kept = split(recorded, ["rig_0__b"])
    assert [[each.trace.name for each in part] for part in (fitted, kept)] == [["rig_0__a", "rig_0__c"], ["rig_0__b"]]
    with pytest.raises(ScenarioError, match="leaves no trace to fit"):
        split(recorded, ["rig_0__a", "rig_0__b", "rig_0__c"])


def test_two_recordings_of_one_name_are_refused(tmp_path: Path) -> None:
    save(tmp_path / "one", "rig_0__a", columns())
    save(tmp_path / "two", "rig_0__a", columns())
    with pytest.raises(TraceError, match=r"rig_0__a\.mat: has the name of .*one"):
        load_campaign(traces(tmp_path, files="**/rig_*.mat"))


@pytest.mark.parametrize("pattern", ["", "/etc/*"])
def test_a_pattern_that_leaves_the_folder_is_refused(tmp_path: Path, pattern: str) -> None:
    with pytest.raises(ScenarioError, match=r"traces\.files: .* is no pattern below a folder"):
        load_campaign(traces(tmp_path, files=pattern))


SCENARIO = {
    "title": "A stand-in",
    "components": {
        "motor": {"model": "dc_motor"},
        "hand": {"model": "pendulum", "parameters": {"angle_start": 0.1, "added_length": 0.1}},
    },
    "connections": study()["connections"],
    "run": {"stop": 1, "step": 0.01},
    "cases": [{"name": "light"}, {"name": "heavy", "set": {"hand.added_mass": 0.2}}],
}


def test_the_cases_of_a_scenario_are_traces_whose_fields_are_their_values(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(json.dumps(SCENARIO))
    heavy, light = load_campaign(TraceSource(tmp_path, scenario=tmp_path / "rig.yaml"))
    assert (heavy.trace.name, light.trace.name) == ("heavy", "light")
    assert heavy.fields["hand.added_mass"] == 0.2 and heavy.fields["hand.added_length"] == 0.1
    assert "hand.added_mass" not in light.fields
    assert heavy.sha256 == sha256(tmp_path / "rig.yaml")
    assert np.ptp(light.trace["hand.angle"]) > 0


BAD_NAME = "its name does not give mass; name it after the pattern"


def spoiled(column: int, value: float, rows: slice = slice(None)) -> np.ndarray:
    matrix = columns()
    matrix[rows, column] = value
    return matrix


@pytest.mark.parametrize(
    ("name", "matrix", "problem"),
    [
        ("rig_heavy__a", columns(), BAD_NAME),
        ("rig__a", columns(), BAD_NAME),
        (
            "rig_0__a",
            spoiled(2, np.nan, slice(40, 42)),
            ".angle: is not finite at t = 0.4 s (2 samples); repair or cut the recording, or leave them out: "
            "`traces.exclude: [{trace: rig_0__a, from: 0.4, to: 0.41",
        ),
        ("rig_0__a", spoiled(1, np.inf, slice(7, 8)), ".voltage: is not finite at t = 0.07 s (1 samples)"),
        ("rig_0__a", spoiled(2, 1.5), ".angle: is constant (1.5); check the column's number"),
        ("rig_0__a", spoiled(1, 0.0), ".voltage: is constant (0); check the column's number"),
        ("rig_0__a", spoiled(0, np.nan, slice(3, 4)), ": time stamp 4 is nan"),
        ("rig_0__a", spoiled(0, 1.0), ": has fewer than two distinct time stamps; check the time column"),
        ("rig_0__a", columns()[:, :2], ": has no column 2; it has 2, counted from 0"),
        ("rig_0__a", columns()[:50], ": lasts 0.49 s, too short for 1 s after 0 s; shorten the windows"),
    ],
)
def test_a_bad_recording_is_one_line_and_nothing_is_written(
    tmp_path: Path, name: str, matrix: np.ndarray, problem: str
) -> None:
    file = save(tmp_path / "data", name, matrix)
    line = refused(tmp_path, tmp_path / "data")
    assert problem in line and (str(file) in line or line.startswith(f"servotwin: {file.stem}"))


def test_a_bad_recording_has_a_traceback_when_two_vs_ask_for_it(tmp_path: Path) -> None:
    save(tmp_path / "data", "rig_0__a", spoiled(2, np.nan))
    result = calibrate(tmp_path, tmp_path / "data", "-vv")
    assert result.exit_code == 2
    assert "Traceback" in result.stderr and result.stderr.count("servotwin: ") == 1
    assert result.stdout == ""


def test_a_truncated_file_is_refused(tmp_path: Path) -> None:
    file = save(tmp_path / "data", "rig_0__a", columns())
    whole = file.read_bytes()
    for length in (len(whole) - 1, len(whole) // 2, 200, 128, 100, 1, 0):
        file.write_bytes(whole[:length])
        assert str(file) in refused(tmp_path, tmp_path / "data"), length


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "rig_0__a.mat").write_text("time,voltage,angle\n0,1,2\n")
    assert "is not a MATLAB v5 or v7.3 file" in refused(tmp_path, tmp_path / "data")


def test_a_missing_variable_is_refused_with_those_there_are(tmp_path: Path) -> None:
    save(tmp_path / "data", "rig_0__a", columns(), variable="E")
    assert "has no variable 'D'; it holds E" in refused(tmp_path, tmp_path / "data")


def test_a_missing_folder_and_one_without_recordings_are_refused(tmp_path: Path) -> None:
    assert "none: no such file or folder; give --data PATH" in refused(tmp_path, tmp_path / "none")
    (tmp_path / "empty").mkdir()
    assert "empty: holds no file 'rig_*.mat'; give --data PATH" in refused(tmp_path, tmp_path / "empty")


def test_a_trace_to_hold_out_that_is_not_there_is_refused_with_those_there_are(tmp_path: Path) -> None:
    save(tmp_path / "data", "rig_0__a", columns())
    line = refused(tmp_path, tmp_path / "data", hold_out=["rig_0__z"])
    assert "traces.hold_out: there is no trace 'rig_0__z'; there are rig_0__a" in line


def calibrate(folder: Path, data: Path, *options: str, **changes: Any) -> Any:
    study_file = write_study(folder / "study.yaml", traces=TRACES | changes)
    command = ["calibrate", str(study_file), "--data", str(data), "--out", str(folder / "out" / "result"), *options]
    return servotwin(*command, env={"COLUMNS": "80"})


def refused(folder: Path, data: Path, **changes: Any) -> str:
    """The one line with which a calibration ends with exit code 2, nothing written."""
    result = calibrate(folder, data, "--json", **changes)
    assert result.exit_code == 2, result.output
    assert json.loads(result.stdout)["error"]["exit_code"] == 2 and "Traceback" not in result.stderr
    (line,) = result.stderr.splitlines()
    assert line.startswith("servotwin: ")
    assert not (folder / "out").exists()
    return str(line)


def test_the_same_campaign_without_faults_is_calibrated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calibration, "processors", lambda: 1)
    for number, grams in enumerate((0, 50)):
        save(tmp_path / "data", f"rig_{grams}__a", columns(grams / 1000, number))
    result = calibrate(tmp_path, tmp_path / "data", "--json")
    assert result.exit_code == 0, result.stderr
    assert json.loads(result.stdout)["fit"]["train"]["median"] > 0.999


def test_names_of_recordings_of_the_small_study_are_read(tmp_path: Path) -> None:
    source = TracesBlock.model_validate(study()["traces"]).source(record(tmp_path), UsedSignals())
    masses = [trace.fields["mass"] for trace in load_campaign(source)]
    assert masses == [0.0, 0.1, 0.05]
