"""Texts and what is binary go from component to component when numbers do."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from fmus.errors import WiringError
from orchestrator import open_system
from orchestrator.engine import Engine, Run, Timing
from orchestrator.fmi.isolation import Isolation
from orchestrator.scenario.exchange import export
from orchestrator.scenario.run import run_scenario
from orchestrator.ssp.checking import check
from orchestrator.ssp.names import Version
from orchestrator.trace import Trace
from tests.support.fmus import quirks
from tests.support.tools.third_party import reference

SAYS = 'm->time < 0.45 ? "idle" : m->time < 0.85 ? "läuft, \\"gut\\"" : "done"'
WIRES = ["lag.said -> a.String_input", "a.String_output -> b.String_input"]
TIMING = Timing(Fraction(1), Fraction(1, 10))


def scenario(folder: Path, wires: Sequence[str] = tuple(WIRES), **run: Any) -> Path:
    quirks.build(folder / "quirks.fmu", ON_TEXT=SAYS)
    feedthrough = {"fmu": str(reference(3, "Feedthrough"))}
    document = {
        "title": "Texts",
        "components": {"b": feedthrough, "a": feedthrough, "lag": {"fmu": "quirks.fmu"}},
        "connections": [*wires],
        "record": ["lag.said", "a.String_output", "b.String_output"],
        "run": {"stop": 1, "step": 0.1} | run,
    }
    (folder / "texts.yaml").write_text(json.dumps(document))
    return folder / "texts.yaml"


def only(file: Path, isolation: Isolation | None = None) -> Trace:
    found = run_scenario(file, isolation=isolation).cases[0].result
    assert found is not None
    return found.trace


@pytest.mark.parametrize("isolation", [None, pytest.param(Isolation(), marks=pytest.mark.slow)])
def test_a_text_passes_gains_within_the_step_and_dynamics_at_its_end(
    tmp_path: Path, isolation: Isolation | None
) -> None:
    trace = only(scenario(tmp_path), isolation)
    said = trace.words("lag.said")
    assert trace.words("a.String_output")[1:] == said[:-1]  # what held at the beginning of the step
    assert trace.words("b.String_output") == ["Set me!", *said[:-1]]
    assert 'läuft, "gut"' in said


def test_in_jacobi_order_each_component_is_a_step_later(tmp_path: Path) -> None:
    trace = only(scenario(tmp_path, order="jacobi"))
    said = trace.words("lag.said")
    assert trace.words("a.String_output")[1:] == said[:-1]
    assert trace.words("b.String_output")[2:] == said[:-2]


def test_bytes_arrive_as_they_were_sent() -> None:
    path = reference(3, "Feedthrough")
    with (
        open_system({"b": path, "a": path}, ["a.Binary_output -> b.Binary_input"]) as system,
        system.simulation(TIMING) as simulation,
    ):
        run = simulation.live(Run(record=["b.Int32_output"]), [], lambda piece: None)
        run.step()
        assert simulation.components["b"].get("Binary_output") == b"foo".hex()
        for sent in (bytes(range(128, 256)), b"", b"\0\0"):
            simulation.components["a"].tune("Binary_input", sent.hex())
            run.step()
            assert simulation.components["b"].get("Binary_output") == sent.hex()


def test_the_compiled_loop_says_that_it_does_not_pass_texts() -> None:
    path = reference(3, "Feedthrough")
    with (
        open_system({"b": path, "a": path}, ["a.String_output -> b.String_input"]) as system,
        system.simulation(replace(TIMING, engine=Engine.COMPILED)) as simulation,
        pytest.raises(WiringError, match="texts of a are connected"),
    ):
        simulation.run(record=["b.Int32_output"])


@pytest.mark.parametrize("version", list(Version))
def test_connected_texts_go_out_and_come_back(tmp_path: Path, version: Version) -> None:
    file = scenario(tmp_path)
    export(file, tmp_path / "t.ssp", version=version)
    assert check(tmp_path / "t.ssp").problems == ()
    assert only(tmp_path / "t.ssp") == only(file)


@pytest.mark.parametrize(
    ("wires", "run", "problem"),
    [
        (["b.String_output -> a.String_input", "a.String_output -> b.String_input"], {"cycles": {}}, "is on a circle"),
        (WIRES, {"order": "iterated"}, "cannot go back|has no mean over a step"),
        (["a.Binary_output -> b.String_input"], {}, "a Binary cannot be connected; connect what is binary to its like"),
    ],
)
def test_what_no_text_can_do_is_refused(tmp_path: Path, wires: list[str], run: dict[str, Any], problem: str) -> None:
    with pytest.raises(WiringError, match=problem):
        run_scenario(scenario(tmp_path, wires, **run))
