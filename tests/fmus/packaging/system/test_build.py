"""Systems as FMUs, from plain values: what makes two of them the same, and models that share a name."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from lxml import etree

from fmus import library
from fmus.errors import ModelError
from fmus.packaging import archive, targets
from fmus.packaging.native import compiler
from fmus.packaging.system.fused import FusedPart, FusedSystem, Wire
from tests.support.fmus.either import opened, schema
from tests.support.fmus.moving import moving
from tests.support.fmus.natives import NAMES
from tests.support.fmus.stepping import stepped

pytestmark = [
    pytest.mark.slow,  # compilers
    pytest.mark.skipif(not compiler.available(), reason="no C compiler here"),
]
SMALL = library.find("state_space")
LARGE = library.of_size(SMALL, {"A": (3, 3), "B": (3, 1), "C": (1, 3), "x_start": (3,)})
PERIOD, TWICE = {"sample_time": 0.01}, {"sample_time": 0.02}
SYSTEM = FusedSystem(
    name="chain",
    description="Two filters",
    parts={
        "a": FusedPart(SMALL, PERIOD | {"A[1,1]": 0.5, "B[1,1]": 1.0, "C[1,1]": 2.0}, {}, 1, False),
        "b": FusedPart(LARGE, TWICE | {"A[3,3]": 0.25, "B[3,1]": 1.0, "C[1,3]": 1.0, "x_start[3]": 4.0}, {}, 2, False),
    },
    wires=(Wire("a.y", "b.u", 3.0, 1.0),),
    base=Fraction(1, 100),
    start=Fraction(0),
    stop=Fraction(1),
    step=Fraction(1, 50),
    outputs=("a.y", "b.y"),
    parameters=("a.A[1,1]", "b.x_start[1]", "b.x_start[2]", "b.x_start[3]"),
)

JOINED = {"motor": "dc_motor", "hand": "pendulum", "slide": "linear_axis"}


def identity(path: Path) -> bytes:
    description = archive.read(path)["modelDescription.xml"]
    return description.partition(b'guid="')[2].partition(b'"')[0]


def test_two_models_of_one_name_and_other_sizes_step_by_their_own_matrices(tmp_path: Path) -> None:
    """x1+ = x1 / 2 + u and x3+ = x3 / 4 + 3 y + 1, by hand; the second takes a step for two of the first."""
    with opened(targets.build_system(SYSTEM, tmp_path / "chain.fmu")) as fmu:
        fmu.start(**{"a.u": 1.0})
        one, other, held = 0.0, 4.0, 4.0
        for k in range(8):
            assert fmu.get("a.y", "b.y") == pytest.approx([2.0 * one, held], abs=1e-12), k
            if k % 2 == 0:
                other = 0.25 * other + 3.0 * 2.0 * one + 1.0
            one = 0.5 * one + 1.0
            held = other if k % 2 else held
            fmu.step(k * 0.01, 0.01)


def test_one_system_gives_the_same_bytes_with_a_cache_and_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SERVOTWIN_CACHE", str(tmp_path / "cache"))
    first, again = (targets.build_system(SYSTEM, tmp_path / name).read_bytes() for name in ("1.fmu", "2.fmu"))
    monkeypatch.setenv("SERVOTWIN_CACHE", "off")
    assert first == again == targets.build_system(SYSTEM, tmp_path / "3.fmu").read_bytes()


OTHERS: list[dict[str, Any]] = [
    {"name": "other"},
    {"wires": (Wire("a.y", "b.u", 3.0, 2.0),)},
    {"base": Fraction(1, 50), "start": Fraction(0)},
    {"parts": {**SYSTEM.parts, "a": replace(SYSTEM.parts["a"], instant=True)}},
    {"parts": {**SYSTEM.parts, "a": replace(SYSTEM.parts["a"], values=PERIOD)}},
    {"finite": False},
    {"outputs": ("b.y",)},
]


@pytest.mark.parametrize("change", OTHERS)
def test_what_does_something_else_is_another_fmu(tmp_path: Path, change: dict[str, Any]) -> None:
    one = targets.build_system(SYSTEM, tmp_path / "one.fmu")
    assert identity(targets.build_system(replace(SYSTEM, **change), tmp_path / "other.fmu")) != identity(one)


def test_values_that_a_model_does_not_have_are_refused(tmp_path: Path) -> None:
    wrong = {**SYSTEM.parts, "a": replace(SYSTEM.parts["a"], values={"gain": 1.0})}
    with pytest.raises(ModelError, match=r"state_space\.gain: no such variable"):
        targets.build_system(replace(SYSTEM, parts=wrong), tmp_path / "a.fmu")
    assert not (tmp_path / "a.fmu").exists()


@pytest.mark.shipped
def test_every_model_of_the_library_moves_inside_as_it_does_alone(tmp_path: Path) -> None:
    """All side by side in one FMU, every input driven, to the last bit: times and steps are whole in binary."""
    models = {name: library.find(name) for name in NAMES}
    everything = replace(
        SYSTEM,
        name="everything",
        base=Fraction(1, 64),
        parts={name: FusedPart(model, moving(name), {}, 1, False) for name, model in models.items()},
        wires=(),
        outputs=tuple(f"{name}.{output.name}" for name, model in models.items() for output in model.of("output")),
        parameters=(),
    )
    path = targets.build_system(everything, tmp_path / "everything.fmu")
    assert validate_fmu(str(path)) == []
    time = np.arange(21) / 64
    with opened(path) as fmu:
        fmu.start()
        rows = []
        for k in range(20):
            fmu.step(k / 64, 1 / 64)
            rows.append(fmu.get(*everything.outputs))
    found = dict(zip(everything.outputs, np.array(rows).T, strict=True))
    for name, model in models.items():
        outputs = [output.name for output in model.of("output")]
        expected = stepped(model, moving(name), outputs, time)[1:]
        assert np.array_equal(np.column_stack([found[f"{name}.{one}"] for one in outputs]), expected), name


def test_ports_that_nothing_inside_joins_are_terminals(tmp_path: Path) -> None:
    """The motor's armature is free, its shaft drives the hand, whose own has its torque from there."""
    parts = {name: FusedPart(library.find(model), {}, {}, 1, False) for name, model in JOINED.items()}
    wires = (Wire("motor.torque", "hand.torque"), Wire("hand.speed", "motor.speed"))
    outputs = ("motor.current", "motor.torque", "hand.speed", "slide.speed")
    system = replace(SYSTEM, parts=parts, wires=wires, outputs=outputs, parameters=())
    path = targets.build_system(system, tmp_path / "chain.fmu", fmi=3)
    document = etree.fromstring(archive.read(path)["terminalsAndIcons/terminalsAndIcons.xml"])
    etree.XMLSchema(etree.parse(schema(3).with_name("fmi3TerminalsAndIcons.xsd"))).assertValid(document)
    members = {
        terminal.get("name"): [one.get("variableName") for one in terminal.iter("TerminalMemberVariable")]
        for terminal in document.iter("Terminal")
    }
    assert members == {
        "motor.armature": ["motor.voltage", "motor.current"],
        "slide.carriage": ["slide.speed", "slide.force"],
    }
    assert validate_fmu(str(path)) == []
