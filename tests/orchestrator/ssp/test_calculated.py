"""Calculated parameters and local variables are sources of connections, as SSP 2.0 has them; in scenarios, too."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML

from fmus.errors import FmuError, InputError, WiringError
from orchestrator.assembly.assembly import ComponentSpec, open_system
from orchestrator.engine import Engine, Order, Timing
from orchestrator.scenario import fusing
from orchestrator.scenario.exchange import export
from orchestrator.scenario.run import run_scenario
from orchestrator.ssp.checking import check
from orchestrator.ssp.document import imported
from orchestrator.ssp.names import Version
from orchestrator.ssp.outline import Tool
from tests.support.simulation import deriving
from tests.support.simulation.ssps import archive, bindings, connection, connectors, real, system, values

CHAIN = ["a.double -> b.k", "10 * b.double + 1 -> c.k", "a.triple -> c.u", "a.double -> b.b"]
GIVEN = {"a": {"k": 3, "u": 2}}
EXPECTED = {"a.y": 6.0, "b.k": 6.0, "b.y": 12.0, "c.k": 121.0, "c.u": 6.0, "c.y": 726.0}


def scenario(folder: Path, connections: list[str], given: dict[str, Any] | None = None, **run: Any) -> Path:
    """Three of the FMU, connected so."""
    fmu = deriving.build(folder)
    parts = {name: {"fmu": fmu.name, "parameters": (given or GIVEN).get(name, {})} for name in "abc"}
    document = {"title": "chain", "components": parts, "connections": connections, "record": [*EXPECTED]}
    YAML().dump(document | {"run": {"stop": 0.3, "step": 0.1, **run}}, folder / "chain.yaml")
    return folder / "chain.yaml"


def last(path: Path) -> dict[str, float]:
    """What the run of a scenario ends with."""
    result = run_scenario(path).cases[0].result
    assert result is not None
    return {name: float(result.trace[name][-1]) for name in result.trace.names}


@pytest.mark.parametrize("order", Order)
def test_calculated_values_pass_along_chains_before_the_first_step(tmp_path: Path, order: Order) -> None:
    assert last(scenario(tmp_path, CHAIN, order=str(order))) == pytest.approx(EXPECTED, rel=1e-12)


@pytest.mark.parametrize("version", Version)
def test_a_system_with_them_comes_back_from_an_ssp(tmp_path: Path, version: Version) -> None:
    path = tmp_path / "chain.ssp"
    export(scenario(tmp_path, CHAIN), path, version=version)
    assert not check(path).problems
    assert last(path) == EXPECTED


def test_a_tool_that_is_not_known_to_pass_them_on_is_told(tmp_path: Path) -> None:
    notes = export(scenario(tmp_path, CHAIN[:1]), tmp_path / "chain.ssp", Tool.ECOS).notes
    assert "a.double -> b.k: ecos is not known to give a parameter a calculated value" in notes


def foreign(path: Path, links: list[str], sets: str = "", version: str = "2.0") -> Path:
    """An SSP of another tool with two of the FMU, in a system of its own each, that lead all of theirs outwards."""
    kinds = {"u": "input", "k": "parameter", "double": "calculatedParameter", "triple": "local", "y": "output"}
    inside = f'<ssd:Component name="in" source="resources/deriving.fmu">{connectors(**kinds)}</ssd:Component>'
    led = [connection(name, f"in.{name}") for name in ("u", "k")]
    led += [connection(f"in.{name}", name) for name in ("double", "triple", "y")]
    parts = [system([inside], led, name, connectors(**kinds)) for name in "ab"]
    outer = connectors(stiffness="parameter", gain="calculatedParameter", seen="output") + sets
    made = system(parts, links, before=outer)
    return archive(path, made, {"resources/deriving.fmu": deriving.build(path.parent)}, version)


def test_an_ssp_leads_them_through_connectors_of_systems(tmp_path: Path) -> None:
    links = [connection("stiffness", "a.k"), connection("a.double", "b.k"), connection("a.triple", "b.u")]
    links += [connection("b.double", "gain"), connection("b.y", "seen")]
    path = foreign(tmp_path / "x.ssp", links, bindings(values({"stiffness": real(4)})))
    found = imported(path)
    assert found.document["components"]["a__in"]["parameters"] == {"k": 4.0}
    assert last(path) == {"b__in.y": 8.0 * 3.0}
    assert not any("cannot be set" in note for note in found.notes)


def test_a_value_of_a_parameter_that_is_calculated_is_told_and_not_used(tmp_path: Path) -> None:
    sets = bindings(values({"b.k": real(7)}))
    path = foreign(tmp_path / "x.ssp", [connection("a.double", "b.k"), connection("b.y", "seen")], sets)
    assert any("b.k takes its value from a.in.double" in note for note in imported(path).notes)
    assert last(path) == {"b__in.y": 2.0}


def test_units_are_converted_where_a_parameter_is_calculated(tmp_path: Path) -> None:
    (tmp_path / "metres").mkdir()
    parts = {"a": ComponentSpec(deriving.build(tmp_path / "metres", "m"), {"k": 0.5}), "b": deriving.build(tmp_path)}
    with open_system(parts, ["a.double -> b.k"]) as opened:
        (link,) = opened.system.settled
    assert link.factor == pytest.approx(1000.0, rel=1e-15)


def test_local_variables_react_within_the_step_as_outputs_do(tmp_path: Path) -> None:
    fmu, wave = deriving.build(tmp_path), np.array([1.0, -2.0, 4.0, 3.0])
    with open_system({"a": fmu, "c": fmu}, ["a.triple -> c.u"], ["a.u"]) as opened:
        for engine in (Engine.PYTHON, Engine.COMPILED):
            timing = Timing(Fraction(3, 10), Fraction(1, 10), engine=engine)
            with opened.simulation(timing) as made:
                trace = made.run({"a.k": 3.0}, {"a.u": wave}, ["a.y", "c.y", "c.u"]).trace
            assert np.array_equal(trace["c.u"][:-1], 3 * wave[:-1])
            assert np.array_equal(trace["c.y"][1:], 3 * wave[:-1]) and np.array_equal(trace["c.y"], trace["a.y"])


@pytest.mark.parametrize(
    ("links", "line"),
    [
        (["a.y -> b.k"], "a.y -> b.k: 'b.k' is a parameter, and 'a.y' changes while it runs"),
        (["a.triple -> b.k"], "a.triple -> b.k: 'b.k' is a parameter, and 'a.triple' changes while it runs"),
        (["a.double -> b.k", "c.double -> b.k"], "b.k: has two sources, a.double and c.double"),
        (["a.double -> b.double"], "'b.double' is a calculatedParameter; only an input can be a target"),
        (["b.double -> a.k"], "a.k: takes its value from b.double; do not set it"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path: Path, links: list[str], line: str) -> None:
    with pytest.raises(InputError) as refused:
        last(scenario(tmp_path, links))
    assert line in str(refused.value)


def test_a_calculated_value_out_of_bounds_is_refused(tmp_path: Path) -> None:
    with pytest.raises(WiringError, match=r"b\.k: is 6000, outside its bounds"):
        last(scenario(tmp_path, ["a.double -> b.k"], {"a": {"k": 3000}}))


def test_calculated_values_that_run_in_a_circle_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FmuError, match=r"run in a circle"):
        last(scenario(tmp_path, ["a.double -> b.k", "b.double -> a.k"], {"c": {"k": 2}}))


def test_one_fmu_of_a_system_takes_local_sources_and_refuses_calculated_parameters(tmp_path: Path) -> None:
    path = scenario(tmp_path, CHAIN)
    with pytest.raises(InputError, match=r"a\.double -> b\.k gives a parameter its value, which is not calculated"):
        fusing.fuse(path)
    fused = fusing.fuse(scenario(tmp_path, ["a.triple -> c.u"], {"c": {"k": 5}}))
    built = fusing.build(fused, tmp_path / "out")
    with open_system({"f": built}) as opened, opened.simulation(Timing(Fraction(3, 10), Fraction(1, 10))) as made:
        trace = made.run({"f.a.u": 2.0}).trace
    assert trace["f.c.y"][-1] == 5 * 3 * 2
