"""Directional and adjoint derivatives of native FMUs against slopes and against the equations by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fmus import library
from fmus.packaging.native import build as native
from fmus.packaging.native import compiler
from tests.support.fmus.either import opened
from tests.support.fmus.natives import CONTINUOUS, VERSIONS, cached, everything, value_of

Built = Callable[[str, int], Path]

pytestmark = [
    pytest.mark.slow,  # processes, compilers or minutes of work
    pytest.mark.skipif(not compiler.available(), reason="no C compiler here"),
]


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", CONTINUOUS)
@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_directional_derivatives_are_the_slopes_of_the_values(
    native_fmu: Built, name: str, fmi: int, data: st.DataObject
) -> None:
    """In initialisation mode: rates and outputs by every input and real parameter, start values included."""
    model = library.find(name)
    knowns = [v for v in model.variables if v.causality != "output" and v.type == "Real"]
    values = {
        v.name: data.draw(value_of(name, v)) if v.causality == "parameter" else data.draw(st.floats(-1, 1))
        for v in knowns
    }
    unknowns = [v.name for v in model.of("output")] + [f"der({state.name})" for state in model.continuous]
    known = data.draw(st.sampled_from([v.name for v in knowns]))
    step = 1e-6 * max(1.0, abs(values[known]))
    with cached(native_fmu(name, fmi)) as fmu:
        for key, value in values.items():
            fmu.set(key, value)
        fmu.fmu.enterInitializationMode()
        found = fmu.sensitivity(unknowns, known)
        sides = []
        for sign in (1, -1):
            fmu.set(known, values[known] + sign * step)
            sides.append(np.array(fmu.get(*unknowns)))
        slope = (sides[0] - sides[1]) / (2 * step)
        scale = 1 + np.abs(sides[0]) + np.abs(slope)
        assert np.abs(found - slope) / scale == pytest.approx(0, abs=1e-4), known


@pytest.mark.parametrize("fmi", VERSIONS)
def test_derivatives_by_the_states_are_those_of_the_equations(native_fmu: Built, fmi: int) -> None:
    with opened(native_fmu("pendulum", fmi)) as fmu:
        fmu.start(angle_start=0.7, speed_start=3.0, viscous_friction=0.002)
        inertia, weight = 0.00325, 0.04905
        found = fmu.sensitivity(["der(angle)", "der(speed)", "angle", "energy"], "angle")
        assert found == pytest.approx([0, -weight / inertia * math.cos(0.7), 1, weight * math.sin(0.7)])
        found = fmu.sensitivity(["der(angle)", "der(speed)", "angle", "energy"], "speed")
        assert found == pytest.approx([1, -0.002 / inertia, 0, inertia * 3.0])
        assert fmu.sensitivity(["der(speed)", "angle"], "torque") == pytest.approx([1 / inertia, 0])


def test_adjoint_derivatives_are_the_transposed_ones(native_fmu: Built) -> None:
    with opened(native_fmu("pendulum", 3)) as fmu:
        fmu.start(angle_start=0.7, speed_start=3.0)
        unknowns, knowns = ["der(speed)", "energy", "angle"], ["angle", "speed", "torque", "inertia"]
        jacobian = np.array([fmu.sensitivity(unknowns, known) for known in knowns]).T
        seed = [0.3, -2.0, 5.0]
        references = [[fmu.variables[name].valueReference for name in names] for names in (unknowns, knowns)]
        found = fmu.fmu.getAdjointDerivative(*references, seed, len(knowns))
        assert found == pytest.approx(jacobian.T @ seed)


@pytest.mark.parametrize("fmi", VERSIONS)
def test_derivatives_of_a_model_with_every_function_are_its_slopes(tmp_path: Path, fmi: int) -> None:
    path = native.build(everything(), tmp_path / "all.fmu", fmi=fmi)
    unknowns = ["der(x)", "y", "z"]
    with opened(path) as fmu:
        for known, at in (("a", 0.73), ("b", -0.4), ("k", 1.3), ("x_start", 0.6)):
            step = 1e-6
            fmu.fmu.reset()
            fmu.set(known, at)
            fmu.fmu.enterInitializationMode()
            found = np.array(fmu.sensitivity(unknowns, known))
            sides = []
            for sign in (1, -1):
                fmu.set(known, at + sign * step)
                sides.append(np.array(fmu.get(*unknowns)))
            assert found == pytest.approx((sides[0] - sides[1]) / (2 * step), rel=1e-5, abs=1e-7), known
