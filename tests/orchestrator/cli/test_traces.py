"""The commands on traces, and how they are told to read one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from orchestrator import formats
from orchestrator.trace import Trace
from tests.support.commands import only_json, servotwin
from tests.support.identification.small_study import record, write_study

pytestmark = pytest.mark.usefixtures("here")


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Those of the small rig."""
    return sorted(record(tmp_path_factory.mktemp("recordings")).glob("*.csv"))


def test_traces_are_described_converted_and_plotted(recordings: list[Path], tmp_path: Path) -> None:
    document = only_json(servotwin("trace", "info", *recordings, "--json"))
    assert [trace["name"] for trace in document["traces"]] == [path.stem for path in recordings]
    copy = tmp_path / "copy.mat"
    document = only_json(servotwin("trace", "convert", recordings[0], copy, "--json"))
    assert document["samples"] == 101
    one, other = (formats.read(path).trace for path in (recordings[0], copy))
    np.testing.assert_array_equal(one["angle"], other["angle"])
    document = only_json(servotwin("trace", "plot", *recordings, "--out", tmp_path / "a.html", "--json"))
    assert Path(document["report"]).read_text().count("rig_0__a") > 0


def test_a_study_tells_how_recordings_are_read(recordings: list[Path], tmp_path: Path) -> None:
    text = recordings[0].read_text().split("\n", 1)[1]
    (tmp_path / "bare.csv").write_text(text)
    study = write_study(tmp_path / "s.yaml", traces={"files": "*.csv", "layout": {"time": 0, "columns": {"theta": 2}}})
    document = only_json(servotwin("trace", "info", tmp_path / "bare.csv", "--layout", study, "--json"))
    assert [signal["name"] for signal in document["traces"][0]["signals"]] == ["theta"]


def test_info_prints_the_layout_that_the_other_commands_take(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_bytes("Zeit [ms];Drehzahl [°/s]\n0;1,5\n2;2,5\n".encode("cp1252"))
    shown = servotwin("trace", "info", tmp_path / "log.csv")
    assert "its numbers have decimal commas" in shown.stdout and "first rows" in shown.stdout
    assert servotwin("info", tmp_path / "log.csv").stdout == shown.stdout
    refused = servotwin("trace", "info", tmp_path / "log.csv", "--columns", "1")
    assert refused.exit_code == 2 and "names no signal; write --columns SIGNAL=1" in refused.stderr
    (tmp_path / "layout.yaml").write_text(shown.stdout[shown.stdout.index("layout:") :], encoding="utf-8")
    copies = []
    for number, said in enumerate([["--layout", tmp_path / "layout.yaml"], ["--time", 0, "--columns", "Drehzahl=1"]]):
        copies.append(tmp_path / f"{number}.parquet")
        only_json(servotwin("trace", "convert", tmp_path / "log.csv", copies[-1], *said, "--json"))
    one, other = (formats.read(path).trace for path in copies)
    assert one.time.tolist() == other.time.tolist() == [0.0, 0.002]
    assert one["Drehzahl"].tolist() == other["Drehzahl"].tolist() == [1.5, 2.5] and one.units == {"Drehzahl": "°/s"}


def test_a_converted_trace_is_there_as_a_whole_or_not_at_all(recordings: list[Path], tmp_path: Path) -> None:
    answer = servotwin("trace", "convert", recordings[0], tmp_path / "a.xls")
    assert answer.exit_code == 2 and "format '.xls' is not known; use" in answer.stderr
    trace = Trace(np.arange(3.0), {"a]": np.arange(3.0)})
    formats.write(trace, tmp_path / "a.parquet")
    answer = servotwin("trace", "convert", tmp_path / "a.parquet", tmp_path / "sub" / "b.xyz")
    assert answer.exit_code == 2 and {path.name for path in tmp_path.iterdir()} == {"a.parquet"}
