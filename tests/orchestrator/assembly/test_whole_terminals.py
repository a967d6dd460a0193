"""Terminals joined as wholes: their variables are wired by name or by place, and nothing that does not fit is."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from fmus.errors import FmuFileError, WiringError
from fmus.modelling.model import Model, input_, output
from fmus.modelling.ports import port
from fmus.packaging import archive, targets
from orchestrator.assembly.assembly import open_system
from orchestrator.engine import Result
from orchestrator.scenario.exchange import export
from orchestrator.scenario.fusing import fuse
from orchestrator.scenario.run import run_scenario

XML = "terminalsAndIcons/terminalsAndIcons.xml"
BY_HAND = ("motor.torque -> hand.torque", "hand.speed -> motor.speed")
SYSTEM = """
title: A motor and a pendulum
components:
  motor: {model: dc_motor, parameters: {back_emf: 0.02}}
  hand: {model: MODEL, parameters: {angle_start: 0.4}}
connections: CONNECTIONS
stimuli: {motor.voltage: {constant: 0.002}}
record: [hand.angle, hand.speed, motor.torque, motor.current]
run: {stop: 0.5, step: 0.01}
"""


def written(folder: Path, connections: Iterable[str], model: str = "pendulum") -> Path:
    file = folder / "system.yaml"
    file.write_text(SYSTEM.replace("CONNECTIONS", str([*connections])).replace("MODEL", model))
    return file


def ran(file: Path) -> Result:
    result = run_scenario(file).cases[0].result
    assert result is not None
    return result


@pytest.mark.slow
@pytest.mark.parametrize(("model", "speed"), [("pendulum", "speed"), ("geared_pendulum", "rotor_speed")])
@pytest.mark.parametrize("line", ["motor.shaft -> hand.shaft", "hand.shaft -> motor.shaft"])
def test_two_shafts_are_wired_both_ways_as_by_hand(tmp_path: Path, model: str, speed: str, line: str) -> None:
    by_hand = (BY_HAND[0], f"hand.{speed} -> motor.speed")
    joined, apart = (ran(written(tmp_path, lines, model)).trace for lines in ([line], by_hand))
    assert joined == apart
    assert np.ptp(joined["motor.torque"]) > 0


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_fmus_of_both_versions_are_joined(tmp_path: Path, fmi: int) -> None:
    parts = {"motor": "dc_motor", "hand": "pendulum"}
    files = {name: targets.build(model, tmp_path / f"{name}.fmu", fmi=fmi) for name, model in parts.items()}
    traces = []
    for lines in (["motor.shaft -> hand.shaft"], BY_HAND):
        with open_system(files, lines, ["motor.voltage"]) as system:
            traces.append(system.run(0.2, 0.01, {"hand.angle_start": 0.4}, {"motor.voltage": 0.01}).trace)
    assert traces[0] == traces[1]


def test_an_ssp_and_one_fmu_of_a_system_have_the_wires_of_terminals(tmp_path: Path) -> None:
    file = written(tmp_path, ["hand.shaft -> motor.shaft"])
    export(file, tmp_path / "system.ssp")
    assert ran(tmp_path / "system.ssp").trace["hand.angle"].tolist() == ran(file).trace["hand.angle"].tolist()
    fused = fuse(file).system
    assert {(wire.source, wire.target) for wire in fused.wires} == {
        ("motor.torque", "hand.torque"),
        ("hand.speed", "motor.speed"),
    }


def shaft(name: str, driving: bool, outward: bool) -> Model:
    """One end of a shaft: it gives the torque and takes the speed, or the other way round."""
    given, taken = (output("m", "N.m", "Torque"), input_("w", "rad/s", "Speed"))
    if not driving:
        given, taken = (output("w", "rad/s", "Speed"), input_("m", "N.m", "Torque"))
    return Model(
        name=name,
        description="An end",
        variables=(taken, given),
        outputs=lambda t, x, u, p: {"m": u.w + 3.0} if driving else {"w": 0.0 * u.m + 2.0},
        ports=(port("end", "rotational", outward, speed="w", torque="m"),),
    )


@pytest.mark.slow
@pytest.mark.parametrize(("outward", "sign"), [((True, False), 1), ((False, True), 1), ((False, False), -1)])
def test_a_flow_that_both_count_alike_is_turned_round(outward: tuple[bool, bool], sign: int) -> None:
    parts = {"a": shaft("giver", True, outward[0]), "b": shaft("taker", False, outward[1])}
    with open_system(parts, ["a.end -> b.end"]) as system:
        factors = {str(link.target): link.factor for link in system.system.connections}
    assert factors == {"b.m": sign, "a.w": 1.0}


def changed(file: Path, *replacements: tuple[str, str]) -> Path:
    """The FMU with other terminals."""
    files = archive.read(file)
    text = files[XML].decode()
    for old, new in replacements:
        assert old in text
        text = text.replace(old, new)
    archive.write(file, files | {XML: text.encode()})
    return file


def joined(folder: Path, *replacements: tuple[str, str], both: bool = False, line: str = "") -> set[tuple[str, str]]:
    """The wires where the terminals of the motor are others, or of the pendulum, too."""
    parts = {"motor": "dc_motor", "hand": "pendulum"}
    files = {name: targets.build(model, folder / f"{name}.fmu", fmi=3) for name, model in parts.items()}
    for name in ("motor", "hand") if both else ("motor",):
        changed(files[name], *replacements)
    with open_system(files, [line or "motor.shaft -> hand.shaft"]) as system:
        return {(str(link.source), str(link.target)) for link in system.system.connections}


WIRES = {("motor.torque", "hand.torque"), ("hand.speed", "motor.speed")}
PLUG, SPEED = 'matchingRule="plug"', 'memberName="speed"'
INFLOW = ' variableKind="inflow" />'


@pytest.mark.parametrize(
    ("replacements", "both", "why"),
    [
        ([(PLUG, 'matchingRule="bus"')], False, r"joins a 'bus' to a 'plug'"),
        ([(PLUG, 'matchingRule="org.x.rule"')], True, r"is to be matched by 'org\.x\.rule', which is not known"),
        ([(SPEED, 'memberName="omega"')], False, r"only one of the terminals has omega, speed, and as plugs they fit"),
        ([('variableName="speed"', 'variableName="torque"')], False, r"motor\.torque is output and hand\.speed is out"),
        (
            [('variableName="speed"', 'variableName="none"')],
            False,
            r"motor\.none is no variable and hand\.speed is out",
        ),
        ([("outflow", "signal")], False, r"motor\.torque is a 'signal' and hand\.torque a 'inflow'"),
        (
            [("_servotwin_rotational", "org.fmi-ls-bus.network-terminal")],
            False,
            r"joins terminals of a bus; .* `buses`",
        ),
    ],
)
def test_terminals_that_do_not_match_are_refused(
    tmp_path: Path, replacements: list[tuple[str, str]], both: bool, why: str
) -> None:
    with pytest.raises(WiringError, match=r"motor\.shaft -> hand\.shaft: " + why):
        joined(tmp_path, *replacements, both=both)


def test_two_members_of_one_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FmuFileError, match=r"terminalsAndIcons\.xml: armature: has two members 'voltage'"):
        joined(tmp_path, ('memberName="current"', 'memberName="voltage"'))


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("motor.shaft -> hand.torque", r"motor\.shaft is a terminal, of speed, torque; the other end is none"),
        ("motor.torque -> hand.shaft", r"hand\.shaft is a terminal, of speed, torque; the other end is none"),
        ("2 * motor.shaft -> hand.shaft", r"gives a terminal a factor or an offset"),
        ("motor.shaft -> hand.shift", r"the other end is none; connect it to a terminal"),
        ("motor.armature -> hand.shaft", r"only one of the terminals has current, speed, torque, voltage"),
    ],
)
def test_a_terminal_is_joined_to_a_terminal_and_as_it_is(tmp_path: Path, line: str, why: str) -> None:
    with pytest.raises(WiringError, match=why):
        joined(tmp_path, line=line)


def test_a_shaft_has_one_that_drives_it() -> None:
    parts = {"a": "dc_motor", "b": "dc_motor", "hand": "pendulum"}
    with (
        pytest.raises(WiringError, match=r"hand\.torque: has two sources, a\.torque and b\.torque"),
        open_system(parts, ["a.shaft -> hand.shaft", "b.shaft -> hand.shaft"]),
    ):
        pass


def test_a_sequence_goes_by_places(tmp_path: Path) -> None:
    other = [(PLUG, 'matchingRule="sequence"'), (SPEED, 'memberName="omega"')]
    assert joined(tmp_path, *other, both=True) == WIRES


def test_a_sequence_of_another_length_is_refused(tmp_path: Path) -> None:
    longer = (
        f'<TerminalMemberVariable variableName="voltage" memberName="other"{INFLOW}<TerminalGraphicalRepresentation'
    )
    parts = [targets.build(name, tmp_path / f"{name}.fmu", fmi=3) for name in ("dc_motor", "pendulum")]
    for file in parts:
        changed(file, (PLUG, 'matchingRule="sequence"'))
    changed(parts[0], ("<TerminalGraphicalRepresentation", longer))
    files = dict(zip(("motor", "hand"), parts, strict=True))
    with (
        pytest.raises(WiringError, match="joins 3 members to 2"),
        open_system(files, ["motor.shaft -> hand.shaft"]),
    ):
        pass


def test_a_bus_joins_what_both_have_and_tells_the_rest(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    parts = {"motor": "dc_motor", "hand": "pendulum"}
    files = {name: targets.build(model, tmp_path / f"{name}.fmu", fmi=3) for name, model in parts.items()}
    for file in files.values():
        changed(file, (PLUG, 'matchingRule="bus"'))
    changed(files["hand"], (SPEED, 'memberName="omega"'))
    with caplog.at_level(logging.WARNING), open_system(files, ["motor.shaft -> hand.shaft"]) as system:
        assert [str(link.source) for link in system.system.connections] == ["motor.torque"]
    assert "only one of the terminals has omega, speed, which stays unconnected" in caplog.text


def test_terminals_within_terminals_are_joined_and_can_be_named(tmp_path: Path) -> None:
    parts = {"motor": "dc_motor", "hand": "pendulum"}
    files = {name: targets.build(model, tmp_path / f"{name}.fmu", fmi=3) for name, model in parts.items()}
    outer = '<Terminals><Terminal name="joint" matchingRule="plug">'
    for file in files.values():
        changed(file, ("<Terminals>", outer), ("</Terminals>", "</Terminal></Terminals>"))
    for line in ("motor.joint -> hand.joint", "motor.joint.shaft -> hand.joint.shaft"):
        with open_system(files, [line]) as system:
            assert {(str(link.source), str(link.target)) for link in system.system.connections} == WIRES


def test_what_a_flow_carries_along_is_refused(tmp_path: Path) -> None:
    stream = (
        '<TerminalStreamMemberVariable inStreamMemberName="a" outStreamMemberName="h" '
        'inStreamVariableName="speed" outStreamVariableName="torque" /><TerminalGraphicalRepresentation'
    )
    with pytest.raises(WiringError, match=r"motor\.shaft has h, which a flow carries along"):
        joined(tmp_path, ("<TerminalGraphicalRepresentation", stream))


def test_a_variable_goes_before_a_terminal_of_its_name(tmp_path: Path) -> None:
    wires = joined(tmp_path, ('name="shaft"', 'name="torque"'), line="motor.torque -> hand.torque")
    assert wires == {("motor.torque", "hand.torque")}
