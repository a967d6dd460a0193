"""What stepping the cases of a scenario took, and how their record was made: as plain values, rows and a sentence."""

from __future__ import annotations

from dataclasses import asdict
from typing import NotRequired, TypedDict

from orchestrator.engine import Account, Engine, Result, shares
from orchestrator.scenario.run import ScenarioResult

HEADERS = ("component", "steps", "time [s]", "µs a step", "share [%]")
LOOP = "(the loop itself)"


class ShareDocument(TypedDict):
    """A component's calls and its share of the time."""

    calls: int
    seconds: float
    share: float


class EngineDocument(TypedDict):
    """Which engine stepped, and why that; times in seconds."""

    engine: str
    reason: str
    steps: int
    step: float
    start: float
    reached: float
    seconds: float
    real_time_factor: float
    inside: NotRequired[dict[str, float]]


class SteppingDocument(TypedDict):
    """How a case was stepped, and whose time it was."""

    stepping: EngineDocument
    statistics: dict[str, ShareDocument]
    loop: dict[str, float]


def document_of(result: Result) -> SteppingDocument:
    """One run as plain values: how it was stepped, and each component's and the loop's own share of the time."""
    account = result.account
    *components, loop = shares([(account, result.statistics)])
    stepping: EngineDocument = {
        "engine": str(account.engine),
        "reason": account.reason,
        "steps": account.steps,
        "step": account.step,
        "start": account.start,
        "reached": account.reached,
        "seconds": round(account.seconds, 6),
        "real_time_factor": float(f"{account.real_time_factor:.4g}"),
    }
    return {
        "stepping": stepping if account.taken is None else stepping | {"inside": asdict(account.taken)},
        "statistics": {
            str(part.name): {"calls": part.calls, "seconds": round(part.seconds, 6), "share": round(part.percent, 2)}
            for part in components
        },
        "loop": {"seconds": round(loop.seconds, 6), "share": round(loop.percent, 2)},
    }


def rows_of(result: ScenarioResult) -> list[tuple[str, int, float, float, float]]:
    """A row under `HEADERS` of each component over all cases, the last of the loop itself."""
    parts = shares((made.account, made.statistics) for made in _results(result))
    return [(part.name or LOOP, part.calls, part.seconds, part.microseconds, part.percent) for part in parts]


def sentence_of(result: ScenarioResult) -> str:
    """How all cases were stepped and their record was made."""
    accounts = [made.account for made in _results(result)]
    if not accounts:
        return "Nothing was stepped."
    steps, spent = sum(account.steps for account in accounts), sum(account.seconds for account in accounts)
    factor = sum(account.reached - account.start for account in accounts) / max(spent, 1e-9)
    every = result.keeping.every
    record = "every step" if every == 1 else f"every {every} steps"
    record += ", to file while running" if result.keeping.stream else ""
    return (
        f"{steps:,} steps of {accounts[0].step:g} s in {spent:.3g} s, {factor:,.3g} times real time, "
        f"by {_loop(accounts[0])}{_inside(accounts)}; recorded {record}."
    )


def _inside(accounts: list[Account]) -> str:
    """What steps were taken inside communication steps."""
    taken = [account.taken for account in accounts if account.taken is not None]
    if not taken:
        return ""
    steps, rejected, forced = (sum(getattr(one, key) for one in taken) for key in ("steps", "rejected", "forced"))
    missed = f", {forced:,} of the shortest missed the tolerance" if forced else ""
    shortest = min(one.shortest for one in taken)
    return f", in {steps:,} steps down to {shortest:.3g} s, {rejected:,} were taken back{missed}"


def _loop(account: Account) -> str:
    return "the compiled loop" if account.engine is Engine.COMPILED else f"the loop in Python ({account.reason})"


def _results(result: ScenarioResult) -> list[Result]:
    return [case.result for case in result.cases if case.result is not None]
