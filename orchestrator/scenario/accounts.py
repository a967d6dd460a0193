"""What stepping the cases of a scenario took, and how their record was made: as plain values, rows and a sentence."""

from __future__ import annotations

from typing import Any

from orchestrator.engine import Account, Engine, Result, shares
from orchestrator.scenario.run import ScenarioResult

HEADERS = ("component", "steps", "time [s]", "µs a step", "share [%]")
LOOP = "(the loop itself)"


def document_of(result: Result) -> dict[str, Any]:
    """One run as plain values: how it was stepped, and each component's and the loop's own share of the time."""
    account = result.account
    *components, loop = shares([(account, result.statistics)])
    return {
        "stepping": {
            "engine": str(account.engine),
            "reason": account.reason,
            "steps": account.steps,
            "step": account.step,
            "start": account.start,
            "reached": account.reached,
            "seconds": round(account.seconds, 6),
            "real_time_factor": float(f"{account.real_time_factor:.4g}"),
        },
        "statistics": {
            each.name: {"calls": each.calls, "seconds": round(each.seconds, 6), "share": round(each.percent, 2)}
            for each in components
        },
        "loop": {"seconds": round(loop.seconds, 6), "share": round(loop.percent, 2)},
    }


def rows_of(result: ScenarioResult) -> list[tuple[str, int, float, float, float]]:
    """A row under `HEADERS` of each component over all cases, the last of the loop itself."""
    parts = shares((each.account, each.statistics) for each in _results(result))
    return [(each.name or LOOP, each.calls, each.seconds, each.microseconds, each.percent) for each in parts]


def sentence_of(result: ScenarioResult) -> str:
    """How all cases were stepped and their record was made."""
    accounts = [each.account for each in _results(result)]
    if not accounts:
        return "Nothing was stepped."
    steps, spent = sum(each.steps for each in accounts), sum(each.seconds for each in accounts)
    factor = sum(each.reached - each.start for each in accounts) / max(spent, 1e-9)
    every = result.keeping.every
    record = "every step" if every == 1 else f"every {every} steps"
    return (
        f"{steps:,} steps of {accounts[0].step:g} s in {spent:.3g} s, {factor:,.3g} times real time, "
        f"by {_loop(accounts[0])}; recorded {record}{', to file while running' if result.keeping.stream else ''}."
    )


def _loop(account: Account) -> str:
    return "the compiled loop" if account.engine is Engine.COMPILED else f"the loop in Python ({account.reason})"


def _results(result: ScenarioResult) -> list[Result]:
    return [case.result for case in result.cases if case.result is not None]
