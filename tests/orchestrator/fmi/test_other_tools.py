"""FMUs as other tools zip and link them: names, capitals, modes of files, functions that are not there."""

from __future__ import annotations

import os
import re
import sys
import zipfile
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from fmus.errors import FmuError
from fmus.packaging import archive
from orchestrator.assembly.wiring import wire
from orchestrator.engine import Simulation, Timing
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.slave import Slave
from orchestrator.info import about
from orchestrator.system import Part
from tests.support.fmus import arrays
from tests.support.tools import third_party


def zipped(path: Path, files: dict[str, bytes], mode: int = 0o644) -> Path:
    with zipfile.ZipFile(path, "w") as made:
        for name, content in files.items():
            info = zipfile.ZipInfo("x")
            info.filename = info.orig_filename = name  # as it is, whatever the platform
            info.create_system, info.external_attr = 3, mode << 16
            made.writestr(info, content)
    return path


def end(path: Path) -> list[float]:
    with FmuFile(path) as file:
        system = wire({"c": Part(file.interface)}, [])
        with Simulation(system, {"c": Slave(file, "c")}, Timing(Fraction(1), Fraction(1, 10))) as made:
            return [float(signal[-1]) for signal in (made.run().trace[name] for name in made.outputs)]


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize(
    ("pattern", "instead"),
    [
        ("/", r"\\"),
        ("^", "./"),
        ("^binaries/([^/]*)/", lambda match: f"Binaries/{match[1].title()}/"),
        ("^(resources|sources)/", lambda match: f"./{match[1].upper()}//"),
    ],
    ids=["backslashes", "dot", "capitals of platforms", "capitals of folders"],
)
def test_names_in_archives_are_taken_as_they_are_meant(
    tmp_path: Path, version: int, pattern: str, instead: Any
) -> None:
    source = third_party.reference(version, "Dahlquist")
    files = {re.sub(pattern, instead, name): content for name, content in archive.read(source).items()}
    path = zipped(tmp_path / "odd.fmu", files)
    assert end(path) == end(source)
    there: Any = about(path)
    assert there["platforms"] == (about(source))["platforms"] and there["sources"]


@pytest.mark.skipif(os.name == "nt", reason="there are no modes")
def test_programs_in_an_archive_can_be_executed_when_it_is_unpacked(tmp_path: Path) -> None:
    source = third_party.reference(2, "Dahlquist")
    files = {**archive.read(source), "resources/tool": b"#!/bin/sh\n"}
    for mode in (0o755, 0o644):
        with FmuFile(zipped(tmp_path / f"{mode:o}.fmu", files, mode)) as file:
            tool = file.folder / "resources" / "tool"
            assert os.access(tool, os.X_OK) == bool(mode & 0o111)
            assert tool.stat().st_mode & 0o7022 == 0


@pytest.mark.slow
def test_a_function_that_is_not_there_matters_when_it_is_needed(tmp_path: Path) -> None:
    with FmuFile(arrays.build(tmp_path)) as file:
        slave = Slave(file, "a")
        slave.set({"gain[1,1]": 3.0})
        slave.begin(0.0, None)
        with pytest.raises(FmuError, match=r"^a: its library has no function fmi3GetFMUState; "):
            slave.save()
        slave.close()


@pytest.mark.slow
@pytest.mark.parametrize("declared", ["", ' declaredType="Tick"'])
def test_clocks_and_binary_inputs_are_left_alone_and_told(
    tmp_path: Path, declared: str, caplog: pytest.LogCaptureFixture
) -> None:
    from orchestrator.assembly.assembly import open_system

    clock = f'<Clock name="tick" valueReference="90" causality="input" intervalVariability="triggered"{declared}/>'
    binary = '<Binary name="frames" valueReference="91" causality="input"/>'
    types = ("<TypeDefinitions>", '<TypeDefinitions><ClockType name="Tick" intervalVariability="triggered"/>')
    path = arrays.build(tmp_path, ('<Float64 name="y"', clock + binary + '<Float64 name="y"'), types)
    document: Any = about(path)
    assert [entry["name"] for entry in document["clocks (never ticked)"]] == ["tick"]
    assert [entry["name"] for entry in document["binary variables"]] == ["frames"]
    assert not {"tick", "frames"} & {entry["name"] for entry in document["inputs"]}
    name = f"c{len(declared)}"  # a remark is made once
    with open_system({name: path}) as system:
        assert system.run(1, 0.5).trace[f"{name}.y[2]"][-1] == 2.0
    assert f"{name}: nothing ticks its clocks (tick)" in caplog.text
    assert f"{name}: its binary inputs (frames) keep what the FMU gives them" in caplog.text


def test_an_fmu_of_another_platform_is_described() -> None:
    document: Any = about(third_party.coupled_clutches_for_windows())
    assert document["platforms"] == ["win64"] and not (sys.platform == "win32" and document["sources"])
    assert document["inputs"] and document["outputs"]
