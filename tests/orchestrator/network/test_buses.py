"""Network FMUs exchange frames over a bus of the scenario: when they are sent, who has them when, and what is told.

The FMU refuses to be ticked, given or asked for operations out of order, or more of them than it takes at once.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

from fmus.errors import FmuFileError, InputError, TangentsMissing, WiringError
from orchestrator.assembly.assembly import ComponentSpec, OpenSystem, SystemSpec, assemble
from orchestrator.can import logs
from orchestrator.can.ls_bus import stuffing
from orchestrator.engine import Result, Timing
from orchestrator.engine import Run as EngineRun
from orchestrator.fmi.isolation import Isolation
from orchestrator.network.bus_spec import BusSpec
from orchestrator.scenario.exchange import export
from orchestrator.scenario.results import write_run
from orchestrator.scenario.run import ScenarioFailed, run_scenario

Node = Callable[..., Path]
Run = Callable[..., Result]
DOCTYPE = "<!DOCTYPE x [<!ENTITY y 'z'>]><fmiTerminalsAndIcons"
BUS = {"can0": {"nodes": ["a.Can", "b.Can"], "bitrate": 500_000}}


def bits(identifier: int, count: int) -> int:
    return stuffing.bits(identifier, False, False, 2, count.to_bytes(2, "little"))


def test_a_frame_is_sent_when_its_clock_ticks_and_received_at_the_next_instant(node: Node, run: Run) -> None:
    found = run({"a": (node(), {"first": 0.02, "period": 10}), "b": (node(), {"first": 10})}, BUS)
    assert found.trace["b.received"].tolist() == [0.0, 0.0] + 19 * [1.0]  # from the step that begins at 0.05 on
    assert found.trace["b.last_time"][-1] == pytest.approx(0.05)
    assert found.carried["can0"].frames.time.tolist() == [pytest.approx(0.02 + (bits(0x100, 0) - 3) / 500_000)]


def test_the_step_changes_nothing_about_what_clocks_send(node: Node, run: Run) -> None:
    parts = {"a": (node(), {"period": 0.013, "first": 0.013}), "b": (node(), {"id": 0x80, "period": 0.013})}
    one, other = (run(parts, BUS, step=step).carried["can0"].frames for step in (0.05, 0.002))
    assert len(one) > 100
    assert one.id.tolist() == other.id.tolist()
    np.testing.assert_allclose(one.time, other.time, atol=1e-12)


@pytest.mark.parametrize("kind", ['constant" intervalDecimal="0.1', "changing"])
def test_a_node_sends_at_the_ticks_of_whatever_clock_goes_by_time(node: Node, run: Run, kind: str) -> None:
    def sent(*change: tuple[str, str]) -> list[float]:
        found = run({"a": (node(*change), {"first": 0.0}), "b": (node(), {"first": 10})}, BUS)
        return found.carried["can0"].frames.time.tolist()

    assert len(sent()) == 10 and sent(('intervalVariability="countdown', f'intervalVariability="{kind}')) == sent()


def test_what_a_step_gave_is_sent_when_it_is_over(node: Node, run: Run) -> None:
    given = {"triggered": 1, "first": 0.02, "period": 10}
    found = run({"a": (node(triggered=True), given), "b": (node(), {"first": 10})}, BUS)
    assert found.carried["can0"].frames.time[0] == pytest.approx(0.05 + (bits(0x100, 0) - 3) / 500_000)


def test_simultaneous_frames_go_by_their_identifier_and_losers_may_have_theirs_back(node: Node, run: Run) -> None:
    parts = {
        "a": (node(), {"BusNotifications": True}),
        "b": (node(), {"id": 0x200, "BusNotifications": True}),
        "c": (node(triggered=True), {"id": 0x300, "triggered": 1, "discard": 1, "BusNotifications": True}),
    }
    buses = {"can0": {"nodes": ["a.Can", "b.Can", "c.Can"], "bitrate": 500_000}}
    found = run(parts, buses)
    assert found.carried["can0"].frames.id.tolist() == 9 * [0x100, 0x200]
    assert found.trace["a.confirmed"][-1] == found.trace["b.confirmed"][-1] == 9
    assert (found.trace["c.confirmed"][-1], found.trace["c.lost"][-1]) == (0, 9)
    assert found.trace["c.received"][-1] == 18
    assert found.carried["can0"].remarks == ("9 frames of c.Can that lost arbitration and were given back",)


def test_who_does_not_ask_for_notifications_has_none(node: Node, run: Run) -> None:
    found = run({"a": (node(), {}), "b": (node(), {"id": 0x200})}, BUS)
    assert found.trace["a.confirmed"][-1] == 0
    assert found.trace["a.received"][-1] == 9


def test_a_bus_tells_its_load_and_what_waits(node: Node, run: Run) -> None:
    parts = {"a": (node(), {"period": 0.01, "first": 0.01}), "b": (node(), {"first": 10})}
    slow = run(parts, {"can0": {"nodes": ["a.Can", "b.Can"], "bitrate": 5000}})
    assert slow.trace["can0.load"][2:].tolist() == pytest.approx(19 * [1.0])
    assert slow.trace["can0.waiting"][-1] > 10
    assert re.fullmatch(r"\d+ frames were still waiting at the end", slow.carried["can0"].remarks[0])
    fast = run(parts, BUS)
    sent = sum(bits(0x100, count) for count in range(98))
    assert fast.carried["can0"].load == pytest.approx(sent / 500_000, rel=0.02)


def test_nodes_that_step_less_often_than_the_bus_send_and_receive_all(node: Node, scenario: Any) -> None:
    parts = {"a": (node(), {"period": 0.01, "first": 0.01}), "b": (node(), {"first": 10})}
    file = scenario(parts, BUS, step=0.05)
    document = json.loads(file.read_text())
    document["components"]["a"]["step"], document["components"]["b"]["step"] = 0.25, 0.01
    file.write_text(json.dumps(document))
    result = run_scenario(file).cases[0].result
    assert result is not None
    assert result.trace["b.received"][-1] >= 97
    gaps = np.diff(result.carried["can0"].frames.time)
    np.testing.assert_allclose(gaps, 0.01, atol=1e-4)


def test_a_direct_wire_passes_operations_on_as_they_are(node: Node, run: Run) -> None:
    found = run(
        {"a": (node(), {"rate": 125_000}), "b": (node(), {"first": 10})},
        {"w": {"nodes": ["a.Can", "b.Can"], "direct": True}},
    )
    assert found.trace["b.complaints"][-1] == 1  # the configuration, which a bus would not have passed on
    assert found.trace["b.received"][-1] == 9
    assert not found.carried


def test_a_malformed_operation_is_told_and_given_back(node: Node, run: Run) -> None:
    found = run({"a": (node(), {"spoil": 1}), "b": (node(), {"first": 10})}, BUS)
    said = "1 operations of a.Can that are malformed: one has the code 0x99, which no operation for CAN has"
    assert found.carried["can0"].remarks == (said,)
    assert found.trace["a.complaints"][-1] == 1
    assert found.trace["b.received"][-1] == 8


def test_every_run_begins_with_an_empty_bus(node: Node, scenario: Any) -> None:
    parts = {"a": (node(), {"period": 0.01}), "b": (node(), {"first": 10})}
    cases = {"cases": [{"name": "one"}, {"name": "other"}]}
    one, other = run_scenario(scenario(parts, BUS, more=cases)).cases
    assert one.result is not None
    assert other.result is not None
    assert one.result.carried["can0"].frames.time.tolist() == other.result.carried["can0"].frames.time.tolist()
    assert one.trace["b.received"].tolist() == other.trace["b.received"].tolist()


def test_results_hold_the_frames_as_a_log(node: Node, scenario: Any, tmp_path: Path) -> None:
    result = run_scenario(scenario({"a": (node(), {}), "b": (node(), {"id": 0x200})}, BUS))
    write_run(result, {}, tmp_path / "out")
    told = json.loads((tmp_path / "out" / "manifest.json").read_text())["cases"][0]["buses"]["can0"]
    assert (told["frames"], told["log"], told["remarks"]) == (18, "run.can0.log", [])
    logged = [identifier for batch in logs.read(tmp_path / "out" / told["log"]) for identifier in batch.id.tolist()]
    assert logged == 9 * [0x100, 0x200]


def test_bit_rates_that_contradict_each_other_end_the_run(node: Node, run: Run) -> None:
    parts = {"a": (node(triggered=True), {"triggered": 1, "rate": 125_000}), "b": (node(), {})}
    with pytest.raises(
        ScenarioFailed, match=r"can0\.bitrate: .* 125000 bit/s by a\.Can and to 500000 bit/s by the bus"
    ):
        run(parts, BUS)


def test_a_run_that_its_bus_ends_keeps_what_it_gave_until_then(node: Node, scenario: Any, tmp_path: Path) -> None:
    parts = {"a": (node(), {"first": 0.2}), "b": (node(), {"first": 10})}
    with pytest.raises(ScenarioFailed, match=r"can0: has no bit rate") as failed:
        run_scenario(scenario(parts, {"can0": {"nodes": ["a.Can", "b.Can"]}}))
    assert failed.value.result.cases[0].trace.time[-1] == pytest.approx(0.2)


def test_a_node_does_not_get_what_is_longer_than_it_takes(node: Node, run: Run) -> None:
    parts = {"a": (node(), {}), "b": (node(('maxSize="64"', 'maxSize="17"')), {"first": 10})}
    found = run(parts, BUS)
    assert found.trace["b.received"][-1] == 0
    assert found.carried["can0"].remarks == ("9 operations that b.Can, which takes 17 bytes at once, did not get",)


@pytest.mark.parametrize(
    ("buses", "why"),
    [
        ({"can0": {"nodes": ["a"]}}, r"buses\.can0: 'a' names no component and terminal; .* components are a, b"),
        ({"can0": {"nodes": ["a.Lin"]}}, r"a has no bus terminal 'Lin'; it has Can"),
        ({"a": {"nodes": ["a.Can"]}}, r"buses\.a: is the name of a component, too"),
        ({"x": {"nodes": ["a.Can"]}, "y": {"nodes": ["a.Can"]}}, r"buses\.y: a\.Can is on x already"),
        ({"w": {"nodes": ["a.Can"], "direct": True}}, r"buses\.w: is direct and has 1 nodes"),
        ({"w": {"nodes": ["a.Can", "b.Can"], "direct": True, "bitrate": 1}}, r"`direct` wire passes operations on"),
        ({"can0": {"nodes": [], "bitrate": 1}}, r"buses\.can0\.nodes"),
        ({"can0": {"nodes": ["a.Can"], "bitrate": 0}}, r"buses\.can0\.bitrate"),
    ],
)
def test_a_bus_that_does_not_fit_names_the_place(node: Node, run: Run, buses: dict[str, Any], why: str) -> None:
    with pytest.raises(InputError, match=why):
        run({"a": (node(), {}), "b": (node(), {})}, buses)


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ('org.fmi-ls-bus.network-terminal"', 'something"', r"its FMU has none after FMI-LS-BUS"),
        ('memberName="Rx_Clock"', 'memberName="Clock"', r"terminal Can: has no member Rx_Clock that is a variable"),
        ('variableName="Can.Tx_Data"', 'variableName="id"', r": id: is Float64, parameter, not Binary, output as Tx"),
        ("fmi-ls-bus.can;", "fmi-ls-bus.lin;", r"Can\.Tx_Data: carries application/org\.fmi-standard\.fmi-ls-bus\.lin"),
        ('clocks="3"', 'clocks="4"', r"Can\.Rx_Data: does not belong to the clock Can\.Rx_Clock"),
        ('"triggered"', '"constant" intervalDecimal="1"', r"Can\.Rx_Clock: is no triggered clock"),
        ("</fmiTerminalsAndIcons>", "", r"is not XML"),
        ("<fmiTerminalsAndIcons", DOCTYPE, r"declares a document type"),
        ('hasEventMode="true"', 'hasEventMode="false"', r"a\.Can: is of an FMU without event mode"),
    ],
)
def test_a_terminal_that_does_not_fit_names_the_place(node: Node, run: Run, old: str, new: str, why: str) -> None:
    with pytest.raises((FmuFileError, WiringError), match=why):
        run({"a": (node((old, new)), {}), "b": (node(), {})}, BUS)


def test_what_a_bus_carries_cannot_have_another_source(node: Node, run: Run) -> None:
    wired = {"connections": ["b.Can.Tx_Data -> a.Can.Rx_Data"]}
    with pytest.raises(WiringError, match=r"a\.Can\.Rx_Data: has two sources, a bus and b\.Can\.Tx_Data"):
        run({"a": (node(), {}), "b": (node(), {})}, BUS, more=wired)


def test_nodes_are_neither_isolated_nor_taken_back_nor_exported(node: Node, scenario: Any, tmp_path: Path) -> None:
    file = scenario({"a": (node(), {}), "b": (node(), {})}, BUS)
    with pytest.raises(WiringError, match=r"a: is on a bus, and can be neither isolated"):
        run_scenario(file, isolation=Isolation())
    with pytest.raises(InputError, match=r"buses: an SSP has no buses"):
        export(file, tmp_path / "x.ssp")
    document = json.loads(file.read_text())
    document["run"]["order"] = "iterated"
    file.write_text(json.dumps(document))
    with pytest.raises(WiringError, match=r"can0: carries frames, which are not taken back"):
        run_scenario(file)


def test_frames_carry_no_tangents(node: Node) -> None:
    system = SystemSpec(
        {name: ComponentSpec(node(), {"id": float(place)}) for place, name in enumerate("ab")},
        buses={"can0": BusSpec(("a.Can", "b.Can"), 500_000)},
    )
    timing = Timing(Fraction(1), Fraction(1, 20))
    with (
        TemporaryDirectory() as folder,
        OpenSystem(assemble(system, Path(folder))) as opened,
        opened.simulation(timing) as simulation,
        pytest.raises(TangentsMissing, match=r"can0: carries frames"),
    ):
        simulation.sensitivities(EngineRun(record=["b.received"]), ["a.period"])
