"""An exported SSP gives the same trajectories in other tools as here.

They step all components at once (`order: jacobi`) and the FMUs are the same, so that only rounding may differ: within
1e-9 of a signal's largest magnitude.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy.ssp.simulation import simulate_ssp
from fmpy.ssp.ssd import read_ssd

from fmus import library
from fmus.packaging.native import build as native
from orchestrator.scenario.exchange import export
from orchestrator.scenario.run import run_scenario
from orchestrator.ssp.outline import Tool
from orchestrator.ssp.writing import VALUES
from orchestrator.trace import FloatArray, Trace

pytestmark = pytest.mark.slow

SIGNALS = ("hand.angle", "motor.torque", "push.signal")
STEPS = 100
SCENARIO: dict[str, Any] = {
    "title": "A loop",
    "components": {
        "push": {
            "model": "excitation",
            "parameters": {"shape": "square", "amplitude": 0.3, "frequency": 2, "begin": 0.05},
        },
        "motor": {"model": "dc_motor", "parameters": {"inductance": 0.02}},
        "hand": {"model": "pendulum", "parameters": {"angle_start": 0.4}},
    },
    "connections": ["push.signal -> motor.voltage", "hand.speed -> motor.speed", "motor.torque -> hand.torque"],
    "run": {"stop": 1, "step": 0.01, "order": "jacobi"},
}
SCALED = {"connections": ["0.5 * push.signal + 0.1 -> motor.voltage", *SCENARIO["connections"][1:]]}

ECOS = """
import json, sys
from ecospy import EcosSimulation
with EcosSimulation(step_size=0.01, ssp_path=sys.argv[1]) as simulation:
    simulation.init(parameter_set=sys.argv[2])
    rows = []
    for _ in range(int(sys.argv[3])):
        simulation.step()
        rows.append([simulation.get_real(name.replace(".", "::")) for name in sys.argv[4:]])
print(json.dumps(rows))
"""
LIBCOSIM = """
import json, sys
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimObserver import CosimObserver
execution = CosimExecution.from_ssp_file(sys.argv[1])
observer = CosimObserver.create_last_value()
execution.add_observer(observer)
ends = []
for name in sys.argv[4:]:
    slave, _, variable = name.partition(".")
    index = execution.slave_index_from_instance_name(slave)
    known = execution.slave_variables(index)
    ends.append((index, [one.reference for one in known if one.name.decode() == variable]))
rows = []
for _ in range(int(sys.argv[3])):
    execution.step()
    rows.append([observer.last_real_values(*end)[0] for end in ends])
print(json.dumps(rows))
"""


def here(folder: Path, tool: Tool, **more: Any) -> tuple[Path, Trace]:
    """The SSP for a tool, and what a run of the scenario gives."""
    (folder / "loop.yaml").write_text(json.dumps(SCENARIO | more))
    done = export(folder / "loop.yaml", folder / "loop.ssp", tool)
    assert done.notes == ()
    result = run_scenario(folder / "loop.yaml").cases[0].result
    assert result is not None
    return folder / "loop.ssp", result.trace


def alike(rows: FloatArray, trace: Trace) -> None:
    """See that what a tool has after each step is what the trace has then."""
    for column, name in zip(rows.T, SIGNALS, strict=True):
        expected = trace[name][1 : len(column) + 1]
        assert np.abs(expected).max() > 0
        np.testing.assert_allclose(column, expected, rtol=0, atol=1e-9 * np.abs(expected).max(), err_msg=name)


@pytest.mark.needs("tools")
@pytest.mark.parametrize("more", [{}, SCALED], ids=["plain", "scaled"])
@pytest.mark.parametrize(("tool", "program"), [(Tool.ECOS, ECOS), (Tool.LIBCOSIM, LIBCOSIM)])
def test_a_tool_that_takes_ssps_gives_the_same(tmp_path: Path, tool: Tool, program: str, more: dict[str, Any]) -> None:
    ssp, trace = here(tmp_path, tool, **more)
    arguments = [sys.executable, "-c", program, str(ssp), VALUES, str(STEPS), *SIGNALS]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rows = next(line for line in done.stdout.splitlines() if line.startswith("[["))
    alike(np.array(json.loads(rows)), trace)


def test_fmpy_gives_the_same_from_outputs_that_begin_at_zero(tmp_path: Path) -> None:
    """Its loop starts all connectors at 0, and its row for a time has what is there after the step from it."""
    ssp, trace = here(tmp_path, Tool.FMPY)
    found = simulate_ssp(str(ssp), stop_time=1.0, step_size=0.01)
    alike(np.array([found[name] for name in SIGNALS]).T, trace)


@pytest.mark.parametrize("tool", list(Tool))
def test_fmpy_finds_what_is_written_for_any_tool_valid(tmp_path: Path, tool: Tool) -> None:
    ssp, _ = here(tmp_path, tool)
    assert [component.name for component in read_ssd(str(ssp), validate=True).system.elements] == [
        "push",
        "motor",
        "hand",
    ]


@pytest.mark.parametrize("tool", [Tool.FMPY, Tool.OMSIMULATOR])
def test_what_a_tool_does_otherwise_is_told(tmp_path: Path, tool: Tool) -> None:
    (tmp_path / "loop.yaml").write_text(json.dumps(SCENARIO | SCALED))
    (line,) = export(tmp_path / "loop.yaml", tmp_path / "loop.ssp", tool).notes
    assert line == f"push.signal -> motor.voltage: {tool} does not multiply by 0.5"


@pytest.mark.parametrize("tool", [Tool.ECOS, Tool.LIBCOSIM])
def test_clocks_are_told_of_where_a_tool_aborts_for_them(tmp_path: Path, tool: Tool) -> None:
    native.build(library.find("daq"), tmp_path / "daq.fmu", fmi=3)
    scenario = {"title": "A sampler", "components": {"daq": {"fmu": "daq.fmu"}}, "run": {"stop": 0.1, "step": 0.01}}
    (tmp_path / "sampler.yaml").write_text(json.dumps(scenario))
    notes = export(tmp_path / "sampler.yaml", tmp_path / "sampler.ssp", tool).notes
    told = "daq: ecos aborts where it closes an FMU with clocks; give it one of FMI 2.0"
    assert (told in notes) is (tool is Tool.ECOS)
