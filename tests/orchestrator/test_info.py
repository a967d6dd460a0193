"""`info` says what a file or folder holds, in plain values that JSON can carry, whatever the file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import savemat

from fmus.errors import InputError, ServotwinError
from fmus.files import sha256
from fmus.packaging import archive, targets
from fmus.parameters.write_back import PROVENANCE, write_back
from orchestrator import formats
from orchestrator.formats import Layout
from orchestrator.info import about, about_trace
from orchestrator.results import write_json
from orchestrator.trace import Trace
from tests.support.simulation.ssps import archive as ssp
from tests.support.simulation.ssps import bindings, component, connection, connectors, gain, real, system, values
from tests.support.tools import third_party


def strict(document: dict[str, Any]) -> dict[str, Any]:
    """The document, once it is seen to be JSON of the standard."""
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    return document


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return targets.build("pendulum", tmp_path_factory.mktemp("fmu") / "hand.fmu", target="python")


def by_name(entries: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    return {entry["name"]: entry for entry in entries}


def test_an_fmu_shows_its_variables_with_start_value_and_unit(hand: Path) -> None:
    document = strict(about(hand))
    assert (document["name"], document["fmi"], document["tool"]) == ("pendulum", "2.0", "servotwin")
    assert set(by_name(document["outputs"])) >= {"angle", "speed", "acceleration", "energy"}
    assert set(by_name(document["inputs"])) == {"torque"}
    inertia = by_name(document["parameters"])["inertia"]
    assert (inertia["start"], inertia["unit"]) == ("0.00325", "kg.m2")
    assert document["defaults from resources"] and "calibrated by" not in document


def test_first_rows_show_what_is_infinite_and_leave_what_is_missing(tmp_path: Path) -> None:
    (tmp_path / "holes.csv").write_text("time,x\n0,inf\n1,\n2,-inf\n3,5\n")
    document: Any = about(tmp_path / "holes.csv")
    assert [row["x"] for row in document["rows"]] == ["inf", None, "-inf", 5.0]
    assert [(one["infinite"], one["missing"]) for one in document["signals"]] == [(2, 1)]
    json.dumps(document, allow_nan=False)


def test_what_is_doubtful_of_an_fmu_is_shown(tmp_path: Path) -> None:
    files = archive.read(gain())
    text = files["modelDescription.xml"].replace(b'stepSize="', b'tolerance="0" stepSize="', 1)
    assert b"tolerance" in text and "doubtful" not in about(gain())
    archive.write(tmp_path / "odd.fmu", {**files, "modelDescription.xml": text})
    why = "has the tolerance 0, which should be positive"
    assert about(tmp_path / "odd.fmu")["doubtful"] == [{"name": "default experiment", "why": why}]


@pytest.mark.parametrize(("said", "needs"), [("false", None), ("true", "its tool, installed")])
def test_an_fmu_that_needs_its_tool_says_so(hand: Path, tmp_path: Path, said: str, needs: str | None) -> None:
    files = archive.read(hand)
    xml = files["modelDescription.xml"]
    assert b'needsExecutionTool="true"' in xml
    text = xml.replace(b'needsExecutionTool="true"', f'needsExecutionTool="{said}"'.encode())
    archive.write(tmp_path / "needs.fmu", {**files, "modelDescription.xml": text})
    assert about(tmp_path / "needs.fmu").get("needs") == needs


def test_a_calibrated_fmu_says_by_what(hand: Path, tmp_path: Path) -> None:
    write_back(hand, {"inertia": 0.004}, tmp_path / "c.fmu", {"title": "My study", "method": "output-error"})
    document = strict(about(tmp_path / "c.fmu"))
    assert document["calibrated by"] == "My study (output-error)"
    assert by_name(document["parameters"])["inertia"]["start"] == "0.004"


@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_of_another_supplier_is_shown_too(version: int) -> None:
    document = strict(about(third_party.reference(version, "VanDerPol")))
    assert document["tool"].startswith("Reference FMUs") and not document["defaults from resources"]
    assert "mu" in by_name(document["parameters"])


@pytest.mark.parametrize("text", [b"no json", b"[1]", b"\xff", b'"x"'])
def test_provenance_that_somebody_spoiled_is_refused(hand: Path, tmp_path: Path, text: bytes) -> None:
    archive.write(tmp_path / "odd.fmu", archive.read(hand) | {PROVENANCE: text})
    with pytest.raises(InputError, match=r"odd\.fmu: (is not JSON|holds no JSON object)"):
        about(tmp_path / "odd.fmu")


def test_a_trace_shows_signals_stamps_and_hash(tmp_path: Path) -> None:
    trace = Trace(np.arange(5) * 0.1, {"angle": np.array([1.0, -2, 3, 0, 1])}, {"angle": "rad"})
    formats.write(trace, tmp_path / "run.csv")
    document = strict(about(tmp_path / "run.csv"))
    assert (document["name"], document["samples"], document["to"]) == ("run", 5, pytest.approx(0.4))
    assert document["signals"] == [{"name": "angle", "unit": "rad", "min": -2.0, "max": 3.0}]
    assert document["sha256"] == sha256(tmp_path / "run.csv")


def test_samples_that_are_not_finite_are_counted_and_do_not_spoil_the_document(tmp_path: Path) -> None:
    values = {"a": np.array([1.0, np.nan, 2.0]), "b": np.array([1.0, np.inf, 2.0])}
    formats.write(Trace(np.arange(3.0), values), tmp_path / "run.parquet")
    a, b = strict(about(tmp_path / "run.parquet"))["signals"]
    assert (a["min"], a["max"], a["missing"]) == (1.0, 2.0, 1)
    assert (b["min"], b["max"], b["infinite"]) == (1.0, 2.0, 1)


def test_a_matrix_without_names_is_shown_by_number_once_its_time_is_known(tmp_path: Path) -> None:
    savemat(tmp_path / "D.mat", {"D": np.arange(30.0).reshape(10, 3)})
    with pytest.raises(InputError, match=r"3 columns that may be the time: 0, 1, 2; say which one is `time`"):
        about(tmp_path / "D.mat")
    document = strict(about_trace(tmp_path / "D.mat", Layout(time=0)))
    assert [each["name"] for each in document["signals"]] == ["column_1", "column_2"]
    assert document["layout"] == {"variable": "D", "time": 0, "columns": {"column_1": 1, "column_2": 2}}
    assert document["rows"][1] == {"time": 3.0, "column_1": 4.0, "column_2": 5.0}


def test_a_result_shows_title_figures_and_files(tmp_path: Path) -> None:
    parameters = {"hand.inertia": {"value": 0.004, "std": None, "ci95": None, "unit": "kg.m2"}}
    write_json(tmp_path / "summary.json", {"title": "T", "method": "output-error", "parameters": parameters})
    (tmp_path / "fmus").mkdir()
    (tmp_path / "fmus" / "hand.fmu").write_bytes(b"")
    document = strict(about(tmp_path))
    assert document["name"] == "T" and document["files"] == ["fmus/hand.fmu", "summary.json"]
    assert document["parameters"] == [{"name": "hand.inertia"} | parameters["hand.inertia"]]


@pytest.mark.parametrize("text", [b"{", b"[]", b"3", b"\xff\xfe", b'{"parameters": [1]}', b'{"parameters": {"a": 1}}'])
def test_a_result_that_somebody_spoiled_is_refused(tmp_path: Path, text: bytes) -> None:
    (tmp_path / "summary.json").write_bytes(text)
    with pytest.raises(InputError, match=r"summary\.json: .*; run the command again"):
        about(tmp_path)


def test_what_is_none_of_these_is_refused_with_its_place(tmp_path: Path) -> None:
    (tmp_path / "notes.doc").write_text("x")
    for path, problem in [
        (tmp_path, "holds no result; give a folder with manifest.json or summary.json"),
        (tmp_path / "none", "there is no such file or folder"),
        (tmp_path / "none.fmu", "there is no such file or folder"),
        (tmp_path / "notes.doc", "format '.doc' is not known"),
    ]:
        with pytest.raises(InputError) as refused:
            about(path)
        assert str(refused.value).startswith(f"{path}: {problem}")


@given(content=st.binary(max_size=300), suffix=st.sampled_from([".csv", ".mat", ".parquet", ".txt", ".fmu"]))
def test_any_bytes_are_shown_or_refused(tmp_path_factory: pytest.TempPathFactory, content: bytes, suffix: str) -> None:
    path = tmp_path_factory.getbasetemp() / f"any{suffix}"
    path.write_bytes(content)
    try:
        strict(about(path))
    except ServotwinError as error:
        assert str(path) in str(error) and "\n" not in str(error)


def test_an_ssp_is_shown_with_its_components_wires_and_values(tmp_path: Path) -> None:
    inner = bindings(values({"k": real(5)}))
    inside = system([component("w", inner=inner)], [connection("in", "w.u")], "m", connectors(**{"in": "input"}))
    document = about(ssp(tmp_path / "s.ssp", system([component("a"), inside], [connection("a.y", "m.in")])))
    assert document["components"] == [
        {"name": "a", "in the SSP": "a", "FMU": "gain.fmu"},
        {"name": "m__w", "in the SSP": "m.w", "FMU": "gain.fmu"},
    ]
    assert document["connections"] == [{"connection": "a.y -> m__w.u"}]
    assert document["values"] == [{"name": "m__w.k", "value": 5.0}]
