"""What the FMU of a system does whatever its parts are: models or FMUs."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import pytest
from fmpy import read_model_description
from fmpy.validation import validate_fmu
from lxml import etree

from fmus.packaging import archive
from fmus.packaging.native import compiler
from fmus.packaging.system.build import FLAGS
from tests.support.fmus.either import Either, opened, schema

STRICT = ("-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Wno-sign-conversion", "-Werror")


def shown(of: Either) -> list[float]:
    """All outputs."""
    return of.get(*(name for name, variable in of.variables.items() if variable.causality == "output"))


def advance(of: Either, first: int, last: int) -> list[float]:
    """All outputs after steps first to last."""
    for k in range(first, last):
        of.step(k * 0.001, 0.001)
    return shown(of)


class FusedContract:
    """The claims; a subclass says by `built` of which FMU of the system of many rates, and how variables are named."""

    convention: ClassVar[str]
    MOVED: ClassVar = {"hand.angle_start": 0.7}

    @staticmethod
    def built(folder: Path, fmi: int) -> Path:
        raise NotImplementedError

    @pytest.mark.parametrize("fmi", [2, 3])
    def test_states_resets_and_other_instances_leave_each_other_alone(self, tmp_path: Path, fmi: int) -> None:
        path = self.built(tmp_path, fmi)
        with opened(path) as fmu, opened(path) as other:
            fmu.start(**self.MOVED)
            advance(fmu, 0, 50)
            state = fmu.save()
            later = advance(fmu, 50, 200)
            other.start()
            unmoved = advance(other, 0, 200)
            assert unmoved != later
            fmu.restore(state)
            assert advance(fmu, 50, 200) == later
            fmu.fmu.reset()
            fmu.start()
            assert advance(fmu, 0, 200) == unmoved
            fmu.restore(state)
            assert advance(fmu, 50, 200) == later
            fmu.fmu.reset()
            fmu.start(**self.MOVED)
            assert advance(fmu, 0, 200) == later
            assert shown(other) == unmoved
            fmu.drop(state)

    @pytest.mark.parametrize("fmi", [2, 3])
    def test_it_is_valid_and_its_sources_build_it_again_without_a_warning(self, tmp_path: Path, fmi: int) -> None:
        path = self.built(tmp_path, fmi)
        assert validate_fmu(str(path)) == []
        files = archive.read(path)
        etree.XMLSchema(file=str(schema(fmi))).assertValid(etree.fromstring(files["modelDescription.xml"]))
        described = read_model_description(str(path))
        assert described.variableNamingConvention == self.convention
        run = described.defaultExperiment
        assert (float(run.startTime), float(run.stopTime), float(run.stepSize)) == (0.0, 1.2, 0.002)
        sources = {
            name.removeprefix("sources/"): text.decode() for name, text in files.items() if name.startswith("sources/")
        }
        assert compiler.compile_library(sources, "many_rates", compiler.host(), (*FLAGS, *STRICT))
