"""A bus that is an FMU itself, as the public demonstrations of FMI-LS-BUS have it, between nodes of either kind."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestrator.engine import Result
from tests.support.fmus import bus_simulation

Node = Callable[..., Path]
Run = Callable[..., Result]
WIRES = {
    "one": {"nodes": ["a.Can", "bus.Node1"], "direct": True},
    "other": {"nodes": ["bus.Node2", "b.Can"], "direct": True},
}
STEP = 0.001


@pytest.fixture(scope="module")
def bus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bus_simulation.build(tmp_path_factory.mktemp("bus"))


def between(run: Run, bus: Path, a: tuple[Path, Any], b: tuple[Path, Any], **more: Any) -> Result:
    parts: dict[str, Any] = {"a": a, "bus": (bus, {}), "b": b}
    return run(parts, WIRES, **{"step": STEP, "stop": 1} | more)


@pytest.mark.parametrize("triggered", [False, True], ids=["countdown", "triggered"])
def test_a_frame_takes_its_bits_on_the_bus_and_is_confirmed(node: Node, run: Run, bus: Path, triggered: bool) -> None:
    given = {"first": 0.1005, "period": 10, "rate": 1000, "triggered": int(triggered), "BusNotifications": True}
    found = between(run, bus, (node(triggered=triggered), given), (node(), {"first": 10}))
    sent, bits = 0.101, (44 + 16) / 1000
    trace = found.trace
    ticked = trace.time[np.argmax(trace["bus.carried"] > 0)]
    assert ticked == pytest.approx(sent + bits, abs=2.5 * STEP)
    assert trace["b.received"][-1] == trace["a.confirmed"][-1] == trace["bus.carried"][-1] == 1
    assert trace["b.last_id"][-1] == 0x100
    assert trace["b.last_time"][-1] == pytest.approx(ticked, abs=1.5 * STEP)


@pytest.mark.parametrize("triggered", [False, True], ids=["countdown", "triggered"])
def test_of_two_frames_at_once_the_lower_identifier_goes_first(
    node: Node, run: Run, bus: Path, triggered: bool
) -> None:
    """Each is confirmed to its sender, and nothing is lost; how it was configured first the bus had at the start."""
    late = {"rate": 10_000, "period": 0.1, "triggered": int(triggered)}
    found = between(run, bus, (node(triggered=triggered), late | {"id": 0x300}), (node(triggered=triggered), late))
    a, b = found.trace["a.last_time"], found.trace["b.last_time"]
    rounds = found.trace["bus.carried"][-1]
    assert rounds in (17, 18)
    assert found.trace["a.received"][-1] + found.trace["b.received"][-1] == rounds
    first, second = (np.unique(times[times > 0])[:8] for times in (a, b))
    assert second - first == pytest.approx(np.full(8, 60 / 10_000), abs=2 * STEP)


def test_the_step_bounds_how_late_a_bus_hears_and_is_heard(node: Node, run: Run, bus: Path) -> None:
    given = {"first": 0.05, "period": 0.1, "rate": 100_000}
    for step in (0.001, 0.005):
        found = between(run, bus, (node(), given), (node(), {"first": 10}), step=step)
        times = np.unique(found.trace["b.last_time"])[1:]
        due = 0.05 + 0.1 * np.arange(len(times)) + 60 / 100_000
        assert len(times) in (9, 10)
        assert np.all((times >= due - 1e-9) & (times <= due + 2 * step + 1e-9))
