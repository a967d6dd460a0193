"""The report of a recalibration near a motion: what each way gave, the motion and its invariant, and free runs."""

from __future__ import annotations

import numpy as np

from identification.motion.calibration import MotionCalibration
from identification.motion.motion import Motion
from identification.motion.results import MotionSummary, summary
from identification.motion.tube import Tube
from identification.result_sections import draw_parameters, provenance, verdict_callout
from orchestrator.display.table import Cell
from orchestrator.report import Report, Section, figures
from orchestrator.report.chart import HEIGHT, Chart, Curve, Panel
from orchestrator.trace import FloatArray

SHOWN = 4  # recordings that are drawn
LEAST = 1e-12  # energy that a logarithmic axis shows [J]


def report(result: MotionCalibration) -> Report:
    """The whole report."""
    page = Report(result.study.title, result.study.description)
    found = summary(result)
    _overview(page.section("Result"), result, found)
    _motion(page.section("Motion"), result)
    if result.tube is not None:
        _free_runs(page.section("Free runs in the tube"), result.tube, result.study.take)
    if result.balance is not None:
        _balance(page.section("Balance of energy"), result)
    provenance(page, found)
    return page


def _overview(section: Section, result: MotionCalibration, found: MotionSummary) -> None:
    tube = result.tube
    shown: list[tuple[str, Cell, str]] = []
    if tube is not None:
        error = "free run error"
        shown = [
            (f"{error}, generic", f"{tube.error('generic'):.3g} rad", f"rms over {tube.spec.periods:g} periods"),
            (f"{error}, recalibrated", f"{tube.error(result.study.take):.3g} rad", "the same windows"),
            ("times smaller", f"{tube.improvement(result.study.take):.3g}", ""),
        ]
    if result.orbit is not None and result.off_orbit is not None:
        remark = f"of {result.orbit.amplitude:g} rad"
        shown.append(("amplitude of the recorded motion", f"{100 * result.off_orbit:+.1f} %", remark))
    section.highlights(shown)
    verdict_callout(section, found["verdict"])
    section.warnings(result.warnings)
    draw_parameters(section, found["parameters"], "What is written, with half of the 95 % intervals")
    names = [name for name in result.generic if any(name in one.parameters for one in result.found.values())]
    rows: list[list[Cell]] = [
        ["generic model", *(result.generic[name] for name in names), result.generic["p3"] / result.generic["p1"]]
    ]
    for way, one in result.found.items():
        values = [one.parameters[name].value if name in one.parameters else None for name in names]
        rows.append([way, *values, one.ratios["p3/p1"].value])
    section.table(["way", *names, "p3/p1"], rows, caption="The ways side by side; p3/p1 whatever the unit of energy is")


def _motion(section: Section, result: MotionCalibration) -> None:
    """The motions in the plane of angle and speed, and how their invariant decays (Eq. 114)."""
    shown = result.motions[:SHOWN]
    orbits = [Curve(motion.name, motion.angle, motion.speed, colour=n) for n, motion in enumerate(shown)]
    plane = Chart([Panel("speed [rad/s]", orbits)], x="angle from the equilibrium [rad]", height=2 * HEIGHT)
    section.figure(plane, "The motions, and the orbit that they come to")
    values = result.taken.values
    decays = [
        Curve(motion.name, motion.action, _off_its_orbit(motion, values["p1"], values["p3"]), colour=n)
        for n, motion in enumerate(shown)
    ]
    panel = Panel("energy off the orbit's [J]", decays, log=True)
    decay = Chart([panel], x="integral of the squared speed [rad^2/s]", height=2 * HEIGHT)
    section.figure(decay, "The recalibrated invariant: a line while Eq. 114 holds, then noise")


def _off_its_orbit(motion: Motion, p1: float, p3: float) -> FloatArray:
    """(K,) size of the invariant of Eq. 110 about the mean energy of the last three periods [J]."""
    energy = motion.invariant(p1, p3, 0.0)
    last = motion.time > motion.time[-1] - 3 * motion.period
    return np.maximum(np.abs(energy - float(np.mean(energy[last]))), LEAST)


def _free_runs(section: Section, tube: Tube, take: str) -> None:
    rows: list[list[Cell]] = [
        [name, tube.error(name), None if name == "generic" else tube.improvement(name), max(tube.errors(name).values())]
        for name in tube.judged
    ]
    headers = ["model", "rms error [rad]", "times smaller than generic", "worst window [rad]"]
    section.table(headers, rows, caption=f"{tube.spec.periods:g} periods of {tube.period:.4g} s a window")
    taken, units = tube.judged[take], dict.fromkeys(tube.judged[take].outputs, "rad")
    for index in range(min(SHOWN, len(taken.windows))):
        measured, simulated = taken.traces(index, units)
        runs = [("generic", tube.judged["generic"].traces(index, units)[1]), ("recalibrated", simulated)]
        section.figure(figures.overlay(measured, runs), measured.name)


def _balance(section: Section, result: MotionCalibration) -> None:
    balance = result.balance
    assert balance is not None
    said = {
        "noise": "The sensors' noise explains what the balance leaves over, and gives the intervals.",
        "stretches": "The balance is off by more than the sensors' noise: the intervals come from how much its "
        f"{len(balance.errors)} stretches differ, and what is common to all of them (play, say) is in none.",
    }
    section.callout("ok" if balance.method == "noise" else "warning", said[balance.method])
    panels = []
    for number, name in enumerate([*dict.fromkeys(balance.recordings)][:SHOWN]):
        own = [n for n, recording in enumerate(balance.recordings) if recording == name]
        time, error = (np.concatenate([parts[n] for n in own]) for parts in (balance.times, balance.errors))
        panels.append(Panel(name, [Curve(name, time, error, colour=number)]))
    section.figure(Chart(panels, legend=False), "What the balance leaves over, over p1 [rad^2/s^2]")
