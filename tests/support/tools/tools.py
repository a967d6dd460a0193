"""Runs FMUs in importers that none of us wrote; started as a process of its own, since some of them end one.

    python -m tests.support.tools.tools TOOL < jobs.json > rows.json

A job has `path`, `outputs`, `step` [s], `count` of steps, and the `fmi` version; for model exchange `substeps` of each
step, and for CasADi the states' `start`. Nothing is set in the FMU. The answer holds, for each job, a row of outputs
after each step (the first row is the start where the tool gives it).
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.support.tools import maven

Job = dict[str, Any]
Rows = list[list[float]]

UNFREED: list[Any] = []  # ecos 0.7.2 frees the clocks of FMUs twice when it closes them, and aborts


def references(job: Job) -> list[int]:
    return [described(job).variables[name] for name in job["outputs"]]


class described:  # noqa: N801 - reads as a function
    """Identity and value references, read with the standard library."""

    def __init__(self, job: Job) -> None:
        import xml.etree.ElementTree as ET

        with zipfile.ZipFile(job["path"]) as archive:
            root = ET.fromstring(archive.read("modelDescription.xml"))
        self.identity = root.get("guid") or root.get("instantiationToken") or ""
        self.name = root.get("modelName") or ""
        self.variables = {v.get("name"): int(v.get("valueReference") or 0) for v in root.find("ModelVariables") or ()}


def fmuloader(job: Job) -> Rows:
    """Co-simulation in fmuloader, which demands every function of the standard."""
    about = described(job)
    if job["fmi"] == 2:
        from fmuloader.fmi2 import Fmi2Slave, Fmi2Type

        slave = Fmi2Slave(job["path"], model_identifier=about.name)
        slave.instantiate("tested", Fmi2Type.CO_SIMULATION, guid=about.identity)
        slave.setup_experiment(start_time=0.0)
        slave.enter_initialization_mode()
        get = slave.get_real
    else:
        from fmuloader.fmi3 import Fmi3Slave

        slave = Fmi3Slave(job["path"], model_identifier=about.name)
        slave.instantiate_co_simulation("tested", instantiation_token=about.identity)
        slave.enter_initialization_mode(start_time=0.0)
        get = slave.get_float64
    slave.exit_initialization_mode()
    rows = [get(references(job))]
    for k in range(job["count"]):
        slave.do_step(k * job["step"], job["step"])
        rows.append(get(references(job)))
    slave.terminate()
    slave.free_instance()
    return rows


def fmuloader_exchange(job: Job) -> Rows:
    """Model exchange in fmuloader, integrated by the classical Runge-Kutta method with `substeps` a step."""
    about = described(job)
    if job["fmi"] == 2:
        from fmuloader.fmi2 import Fmi2Slave, Fmi2Type

        slave = Fmi2Slave(job["path"], model_identifier=about.name)
        slave.instantiate("tested", Fmi2Type.MODEL_EXCHANGE, guid=about.identity)
        slave.setup_experiment(start_time=0.0)
        slave.enter_initialization_mode()
        slave.exit_initialization_mode()
        slave.new_discrete_states()
        get, rates = slave.get_real, slave.get_derivatives
    else:
        from fmuloader.fmi3 import Fmi3Slave

        slave = Fmi3Slave(job["path"], model_identifier=about.name)
        slave.instantiate_model_exchange("tested", instantiation_token=about.identity)
        slave.enter_initialization_mode(start_time=0.0)
        slave.exit_initialization_mode()
        slave.update_discrete_states()
        get, rates = slave.get_float64, slave.get_continuous_state_derivatives
    slave.enter_continuous_time_mode()
    n = sum(name.startswith("der(") for name in about.variables)

    def rate(t: float, x: list[float]) -> list[float]:
        slave.set_time(t)
        slave.set_continuous_states(x)
        values: list[float] = rates(n)
        return values

    rows = [get(references(job))]
    x = slave.get_continuous_states(n)
    for k in range(job["count"]):
        x = integrated(rate, k * job["step"], x, job["step"], job["substeps"])
        slave.set_time((k + 1) * job["step"])
        slave.set_continuous_states(x)
        slave.completed_integrator_step()
        rows.append(get(references(job)))
    slave.terminate()
    slave.free_instance()
    return rows


def integrated(rate: Any, t: float, x: list[float], step: float, count: int) -> list[float]:
    """States after a step: `count` steps of the classical Runge-Kutta method."""
    h = step / count
    for i in range(count):
        now = t + i * h
        k1 = rate(now, x)
        k2 = rate(now + h / 2, [a + h / 2 * b for a, b in zip(x, k1, strict=True)])
        k3 = rate(now + h / 2, [a + h / 2 * b for a, b in zip(x, k2, strict=True)])
        k4 = rate(now + h, [a + h * b for a, b in zip(x, k3, strict=True)])
        x = [a + h / 6 * (b + 2 * (c + d) + e) for a, b, c, d, e in zip(x, k1, k2, k3, k4, strict=True)]
    return x


def ecos(job: Job) -> Rows:
    """Co-simulation in ecos."""
    from ecospy.EcosSimulation import EcosSimulation
    from ecospy.EcosSimulationStructure import EcosSimulationStructure

    structure = EcosSimulationStructure()
    UNFREED.append(structure)
    structure.add_model("m", job["path"])
    with EcosSimulation(structure=structure, step_size=job["step"]) as simulation:
        simulation.init()
        rows = []
        for _ in range(job["count"]):
            simulation.step()
            rows.append([simulation.get_real(f"m::{name}") for name in job["outputs"]])
        return rows


def libcosim(job: Job) -> Rows:
    """Co-simulation in libcosim."""
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimLogging import CosimLogLevel, log_output_level
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    log_output_level(CosimLogLevel.WARNING)
    execution = CosimExecution.from_step_size(round(job["step"] * 1e9))
    index = execution.add_local_slave(CosimLocalSlave(job["path"], "m"))
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    rows = []
    for _ in range(job["count"]):
        execution.step()
        rows.append(observer.last_real_values(index, references(job)))
    return rows


def casadi(job: Job) -> Rows:
    """Model exchange in CasADi, which reads the structure from the XML and the Jacobians from the FMU."""
    import casadi as ca

    with tempfile.TemporaryDirectory() as folder:
        zipfile.ZipFile(job["path"]).extractall(folder)
        dae = ca.DaeBuilder("tested", folder)
        f = dae.create("f", ["t", "x", "u"], ["ode", "y"])
        u = dae.start(dae.u()) if dae.u() else []
        order = [dae.y().index(name) for name in job["outputs"]]

        def rate(t: float, x: list[float]) -> list[float]:
            values: list[float] = f(t=t, x=x, u=u)["ode"].full()[:, 0].tolist()
            return values

        def row(t: float, x: list[float]) -> list[float]:
            y = f(t=t, x=x, u=u)["y"].full()[:, 0]
            return [float(y[i]) for i in order]

        start = x = [job["start"][name] for name in dae.x()]
        rows = [row(0.0, x)]
        for k in range(job["count"]):
            x = integrated(rate, k * job["step"], x, job["step"], job["substeps"])
            rows.append(row((k + 1) * job["step"], x))
        if job.get("jacobian"):
            exact = f.factory("J", ["t", "x", "u"], ["jac:ode:x", "jac:ode:u"])(t=0, x=start, u=u)
            rows.append(ca.horzcat(exact["jac_ode_x"], exact["jac_ode_u"]).full().ravel().tolist())
        return rows


def fmi4j(jobs: list[Job]) -> list[Rows]:
    """Co-simulation in FMI4j."""
    return in_java([(job, 0) for job in jobs])


def fmi4j_exchange(jobs: list[Job]) -> list[Rows]:
    """Model exchange in FMI4j, integrated by the classical Runge-Kutta method with `substeps` a step."""
    return in_java([(job, job["substeps"]) for job in jobs])


def in_java(jobs: list[tuple[Job, int]]) -> list[Rows]:
    """Rows of each job from Fmi4j.java; all jobs share the start of Java, which takes longer than they do."""
    lines = [
        (job["path"], str(job["step"]), str(job["count"]), str(inner), ",".join(map(str, references(job))))
        for job, inner in jobs
    ]
    with tempfile.TemporaryDirectory() as folder:  # FMI4j leaves its own library behind
        done = subprocess.run(
            [
                "java",
                *maven.BRIEF,
                f"-Djava.io.tmpdir={folder}",
                "-cp",
                f"{maven.jars(maven.FMI4J)}/*",
                str(Path(__file__).with_name("Fmi4j.java")),
            ],
            input="".join("\t".join(line) + "\n" for line in lines),
            stdout=subprocess.PIPE,
            text=True,
            check=True,
        )
    answers = done.stdout.removesuffix("\n\n").split("\n\n")
    return [[[float(value) for value in row.split()] for row in rows.split("\n")] for rows in answers]


def one_by_one(tool: Callable[[Job], Rows]) -> Callable[[list[Job]], list[Rows]]:
    return lambda jobs: [tool(job) for job in jobs]


TOOLS: dict[str, Callable[[list[Job]], list[Rows]]] = {
    tool.__name__: one_by_one(tool) for tool in (fmuloader, fmuloader_exchange, ecos, libcosim, casadi)
} | {tool.__name__: tool for tool in (fmi4j, fmi4j_exchange)}


def main() -> None:
    jobs = json.load(sys.stdin)
    out = os.dup(1)
    os.dup2(2, 1)  # some tools write to stdout
    rows = TOOLS[sys.argv[1]](jobs)
    Path(f"/dev/fd/{out}").write_text(json.dumps(rows))
    os._exit(0)


if __name__ == "__main__":
    main()
