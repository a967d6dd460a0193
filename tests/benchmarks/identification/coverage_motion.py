"""Do the 95 % intervals of a recalibration near a motion cover? Two approaches to an orbit, from either side, a draw.

Where the model has all that the rig has, as it should be; with play in the rig's gear, which no parameter stands for,
the intervals say how well the figures repeat, and how often they hold the rig's is only told.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from identification.motion.balance import Values, energy_balance
from identification.motion.motion import Motion, recorded_motion
from orchestrator.scenario.run import run_scenario
from orchestrator.trace import Trace
from tests.support.identification.energy_swings import GENERIC, RIG, Swing

from ..figure import Figure, Interval, coverage, share_inside

SCENARIO = Path(__file__).parents[3] / "scenarios" / "butterfly" / "motion" / "rig.yaml"
NOISE = (1e-4, 0.01)  # of angle [rad] and speed [rad/s]
DRY = (3.2e-3, 6.2e-3)  # [N m]
DRAWS, WITH_PLAY = 200, 60
MODEL: Values = {"p1": GENERIC["p1"], "p2": GENERIC["p2"], "p3": GENERIC["p3"], "p4": RIG["p4"]}
TRUTH = {"p3/p1": RIG["p3"] / RIG["p1"], "p4/p1": RIG["p4"] / RIG["p1"]}


def motion(trace: Trace, equilibrium: float = 0.0) -> Motion:
    return recorded_motion(trace, equilibrium_angle=equilibrium, voltage="voltage")


def intervals(swing: Swing, draws: int) -> list[dict[str, Interval]]:
    """Ratio, or dry friction where there is some -> 95 % interval, for each draw of the sensors' noise."""
    sides = (replace(swing, start=start).recorded(draws, seed) for seed, start in enumerate((0.6, 1.4)))
    found = []
    for pair in zip(*sides, strict=True):
        balance = energy_balance([motion(trace) for trace in pair], MODEL, dry_friction=any(swing.dry))
        dry = {name: one for name, one in balance.parameters.items() if name.startswith("dry")}
        found.append({name: one.ci95 for name, one in [*balance.ratios.items(), *dry.items()]})
    return found


def with_play(draws: int) -> list[dict[str, Interval]]:
    """Ratio -> 95 % interval, from runs of the rig's FMUs with dry friction and play."""
    found = []
    for draw in range(draws):
        seeds = {"encoder.seed": 1000 + draw, "tachometer.seed": 5000 + draw}
        result = run_scenario(SCENARIO, seeds)
        motions = [motion(result.recorded(case), 0.979) for case in result.cases]
        found.append({name: one.ci95 for name, one in energy_balance(motions, MODEL).ratios.items()})
    return found


def figures(draws: int = DRAWS, played: int = WITH_PLAY) -> list[Figure]:
    """Coverage with the sensors' noise alone, with dry friction, and with play."""
    noise = intervals(Swing(noise=NOISE), draws)
    dry = intervals(Swing(noise=NOISE, dry=DRY), draws)
    truth = {"dry_positive": DRY[0], "dry_negative": DRY[1]}
    found = coverage("motion", noise, {**TRUTH, "p2/p4": RIG["p2"] / RIG["p4"]})
    found += coverage("motion with dry friction", dry, {**TRUTH, **truth})
    play = with_play(played)
    return found + [
        Figure(
            f"motion with play: {name} in its 95 % interval",
            "-",
            f"{100 * share_inside([p[name] for p in play], t):.0f} %",
        )
        for name, t in TRUTH.items()
    ]
