"""What native FMUs refuse, and the words they find for it."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fmpy.fmi1 import FMICallException

from fmus.modelling.instance import Instance, StepError
from fmus.modelling.model import Model, Requirement, State, output, parameter
from fmus.packaging.native import build as native
from fmus.packaging.native import compiler
from tests.support.fmus.either import opened
from tests.support.fmus.natives import VERSIONS

Built = Callable[[str, int], Path]

pytestmark = [
    pytest.mark.slow,  # processes, compilers or minutes of work
    pytest.mark.skipif(not compiler.available(), reason="no C compiler here"),
]


def unstable(**functions: Any) -> Model:
    return Model(
        name="unstable",
        description="Runs away",
        derivatives=lambda t, x, u, p: {"a": p.rate * x.a**2, "b": 0.0},
        variables=(
            output("a", "1", "Output"),
            parameter("a_start", "1", 10.0, "Start"),
            parameter("rate", "1", 1.0, "Rate"),
        ),
        states=(State("a", "a_start"), State("b")),
        **({"solver_step": lambda p: 0.01} | functions),
    )


@pytest.mark.parametrize("fmi", VERSIONS)
def test_a_state_that_is_not_finite_is_an_error_with_the_words_of_the_instance(tmp_path: Path, fmi: int) -> None:
    instance = Instance(unstable(), {"a_start": math.nan})
    with pytest.raises(StepError) as error:
        instance.step(0.0, 0.5)
    with opened(native.build(unstable(), tmp_path / "u.fmu", fmi=fmi)) as fmu:
        fmu.start(a_start=math.nan)
        with pytest.raises(FMICallException):
            fmu.step(0.0, 0.5)
        assert fmu.log == [(3, "logStatusError", f"unstable: {error.value}")]
        fmu.fmu.reset()
        fmu.start()
        with pytest.raises(FMICallException):
            fmu.step(0.0, 0.5)
        assert "unstable: state 'a' is" in fmu.log[-1][2]


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("step", ["p.rate - 1", "p.rate * -1", "1e-30 * p.rate"])
def test_a_solver_step_that_leads_nowhere_is_an_error_and_not_a_loop(tmp_path: Path, fmi: int, step: str) -> None:
    model = unstable(solver_step=eval(f"lambda p: {step}"))
    with opened(native.build(model, tmp_path / "u.fmu", fmi=fmi)) as fmu:
        fmu.start()
        with pytest.raises(FMICallException):
            fmu.step(0.0, 0.5)


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan])
def test_a_sample_time_that_is_not_positive_is_an_error_and_not_a_loop(
    native_fmu: Built, fmi: int, value: float
) -> None:
    with opened(native_fmu("daq", fmi)) as fmu:
        fmu.start(sample_time=value)
        with pytest.raises(FMICallException):
            fmu.step(0.0, 0.5)
        assert "'sample_time' is" in fmu.log[-1][2]


@pytest.mark.parametrize("fmi", VERSIONS)
def test_model_exchange_checks_the_requirements_and_the_states_too(tmp_path: Path, fmi: int) -> None:
    of_parameters = Requirement(lambda t, x, u, p: p.rate > 0, "the rate is not 100% positive")
    of_states = Requirement(lambda t, x, u, p: x.a > 0, "a is not 100% positive")
    path = native.build(unstable(requirements=(of_parameters, of_states)), tmp_path / "u.fmu", fmi=fmi)
    with opened(path, exchange=True) as fmu:
        with pytest.raises(FMICallException):
            fmu.start(rate=-1.0)
        assert fmu.log[-1] == (3, "logParameters", "unstable: rate = -1: the rate is not 100% positive")
        fmu.fmu.reset()
        fmu.start(a_start=-1.0)
        with pytest.raises(FMICallException):
            fmu.fmu.enterContinuousTimeMode()
        assert fmu.log[-1][2] == "unstable: a is not 100% positive"
        fmu.fmu.reset()
        fmu.start(a_start=math.inf)
        fmu.fmu.enterContinuousTimeMode()
        with pytest.raises(FMICallException):
            fmu.fmu.completedIntegratorStep()
        assert "state 'a' is inf" in fmu.log[-1][2]


@pytest.mark.parametrize("fmi", VERSIONS)
def test_functions_are_refused_in_modes_that_do_not_allow_them(native_fmu: Built, fmi: int) -> None:
    with opened(native_fmu("pendulum", fmi)) as fmu:
        with pytest.raises(FMICallException):
            fmu.step(0.0, 0.1)
        assert fmu.log[-1][2] == f"pendulum: fmi{fmi}DoStep may not be called in instantiated mode"
        fmu.start()
        for forbidden in (fmu.fmu.enterInitializationMode, fmu.fmu.exitInitializationMode):
            with pytest.raises(FMICallException):
                forbidden()
        fmu.step(0.0, 0.1)
        fmu.fmu.terminate()
        with pytest.raises(FMICallException):
            fmu.step(0.1, 0.1)
        assert fmu.get("inertia") == [0.00325]


@pytest.mark.parametrize("fmi", VERSIONS)
def test_a_sampled_model_cannot_be_instantiated_for_model_exchange(native_fmu: Built, fmi: int) -> None:
    log: list[tuple[int, str, str]] = []
    with pytest.raises(Exception, match=r"[Ii]nstantiate"), opened(native_fmu("daq", fmi), exchange=True, log=log):
        pass
    assert log == [(3, "logStatusError", "daq: offers co-simulation only")]


@pytest.mark.parametrize("fmi", VERSIONS)
def test_the_token_of_another_fmu_is_refused(native_fmu: Built, fmi: int) -> None:
    with pytest.raises(Exception, match=r"[Ii]nstantiate"), opened(native_fmu("pendulum", fmi), guid="{other}"):
        pass


@pytest.mark.parametrize("fmi", VERSIONS)
def test_references_that_are_no_variable_of_the_type_are_refused(native_fmu: Built, fmi: int) -> None:
    with opened(native_fmu("daq", fmi)) as fmu:
        seed = fmu.variables["seed"].valueReference
        reals, wholes = ("getReal", "getInteger") if fmi == 2 else ("getFloat64", "getInt32")
        for name, reference in ((reals, seed), (reals, 9999), (reals, 2**32 - 1), (wholes, 0)):
            with pytest.raises(FMICallException):
                getattr(fmu.fmu, name)([reference])
            assert f"value reference {reference} is no variable of this type" in fmu.log[-1][2]
        assert getattr(fmu.fmu, wholes)([seed]) == [1]


@pytest.mark.parametrize("fmi", VERSIONS)
def test_events_are_logged_when_asked_for_and_errors_always(native_fmu: Built, fmi: int) -> None:
    path = native_fmu("pendulum", fmi)
    with opened(path, logging=True) as loud, opened(path) as quiet:
        for fmu in (loud, quiet):
            fmu.start()
            fmu.step(0.0, 0.1)
        assert [category for _, category, _ in loud.log] == ["logEvents", "logEvents"]
        assert "inner steps are at most 0.01 s long" in loud.log[-1][2]
        assert quiet.log == []
