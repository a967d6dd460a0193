"""A controller's gain is changed while it runs: in FMUs of both packagings, here and isolated."""

from __future__ import annotations

from pathlib import Path

import pytest

from fmus.errors import WiringError
from fmus.modelling.model import Model, State
from fmus.models import parameter
from orchestrator.assembly.assembly import ComponentSpec, OpenSystem, SystemSpec, assemble
from orchestrator.engine import Engine, Run, Timing
from orchestrator.fmi.isolation import Isolation
from orchestrator.rational import seconds
from orchestrator.trace import joined

STEP = seconds(0.01, "step")
VALUES = {"kp": 2.0, "kd": 0.0, "compensation_voltage": 0.0, "sample_time": 0.01}


@pytest.mark.slow
@pytest.mark.parametrize("isolation", [None, Isolation()], ids=["here", "isolated"])
@pytest.mark.parametrize("engine", [Engine.PYTHON, Engine.AUTO])
@pytest.mark.parametrize("target", ["native", "python"])
def test_a_gain_acts_from_the_step_on_at_which_it_is_changed(
    tmp_path: Path, target: str, engine: Engine, isolation: Isolation | None
) -> None:
    made = assemble(SystemSpec({"law": ComponentSpec("pd", VALUES)}), tmp_path, (), target)
    alone = assemble(SystemSpec({"law": ComponentSpec(made.files["law"])}), tmp_path)  # a file, which can be isolated
    pieces = []
    with (
        OpenSystem(alone) as opened,
        opened.simulation(Timing(100 * STEP, STEP, engine=engine), isolation) as simulation,
    ):
        values = {f"law.{name}": value for name, value in VALUES.items()}
        run = simulation.live(Run(values, {}, ["law.voltage"]), ["law.voltage"], pieces.append, None)
        assert {"law.kp", "law.kd", "law.reference"} <= run.tuned.ports.keys()
        assert not {"law.sample_time", "law.voltage_limit"} & run.tuned.ports.keys()
        run.change("law.reference", 0.5, "a test")
        run.step()
        assert run.outputs == [1.0]
        assert run.change("law.kp", 6.0, "a test").value == 6.0
        run.step()
        assert run.outputs == [3.0]
        with pytest.raises(WiringError, match=r"law\.sample_time: cannot be changed"):
            run.tuned.checked("law.sample_time", 0.02)
        result = run.result()
    trace = joined(pieces)
    assert trace["law.kp"].tolist() == [2.0, 6.0, 6.0] and trace["law.reference"].tolist() == [0.5] * 3
    assert trace.unit("law.reference") == "V" and len(result.changes) == 2


def test_what_states_samples_or_the_solver_depend_on_cannot_be_tunable() -> None:
    gain = parameter("gain", "1", 1.0, "Gain", tunable=True)
    period = parameter("period", "s", 0.1, "Sample period", tunable=True)
    sampled = (State("held", 0.0, sampled=True),)

    def update(t: float, x: object, u: object, p: object) -> dict[str, float]:
        return {"held": 0.0}

    assert Model("good", "", (gain, parameter("period", "s", 0.1, "")), sampled, update=update, sample_time="period")
    with pytest.raises(ValueError, match="'period' cannot be tunable"):
        Model("bad", "", (period,), sampled, update=update, sample_time="period")
    with pytest.raises(ValueError, match="'gain' cannot be tunable"):
        Model("bad", "", (gain,), (State("x", 0.0),), derivatives=update, solver_step=lambda p: 0.1)
