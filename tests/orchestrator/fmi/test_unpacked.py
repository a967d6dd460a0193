"""FMUs are unpacked once for all that open equal files; the folder goes with the last of them."""

from __future__ import annotations

import shutil
import sys
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from threading import Thread

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fmus.packaging import archive, targets
from fmus.packaging.native import compiler
from orchestrator.assembly.wiring import wire
from orchestrator.engine import Result, Simulation, Timing
from orchestrator.fmi import unpacked
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.slave import Slave
from orchestrator.system import Part
from tests.support.tools import third_party

pytestmark = pytest.mark.usefixtures("scratch")

XML = "modelDescription.xml"


def said_once(source: Path, target: Path) -> Path:
    """The FMU with the claim that it can be instantiated only once in a process."""
    files = archive.read(source)
    text = files[XML].replace(b"<CoSimulation", b'<CoSimulation canBeInstantiatedOnlyOncePerProcess="true"')
    assert text != files[XML]
    archive.write(target, {**files, XML: text})
    return target


def five(stack: ExitStack, path: Path, **values: float) -> Result:
    """Five components of one file, each with its own number in the given parameters, run."""
    files = {f"c{i}": stack.enter_context(FmuFile(path)) for i in range(5)}
    system = wire({name: Part(file.interface) for name, file in files.items()}, [])
    slaves = {name: Slave(file, name) for name, file in files.items()}
    made = stack.enter_context(Simulation(system, slaves, Timing(Fraction(1), Fraction(1, 10))))
    return made.run({f"c{i}.{name}": i * value for i in range(5) for name, value in values.items()})


def libraries(scratch: Path) -> set[str]:
    """Shared libraries of this process that were unpacked by this test."""
    lines = Path("/proc/self/maps").read_text().splitlines()
    return {line.split()[5] for line in lines if str(scratch) in line and ".so" in line}


def alone(path: Path, **values: float) -> Result:
    with FmuFile(path) as file:
        system = wire({"c": Part(file.interface)}, [])
        with Simulation(system, {"c": Slave(file, "c")}, Timing(Fraction(1), Fraction(1, 10))) as made:
            return made.run({f"c.{name}": value for name, value in values.items()})


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize(("once", "count"), [(False, 1), (True, 5)])
def test_a_library_is_loaded_once_for_all_unless_it_can_be_used_only_once(
    scratch: Path, tmp_path: Path, version: int, once: bool, count: int
) -> None:
    path = third_party.reference(version, "Dahlquist")
    if once:
        path = said_once(path, tmp_path / "once.fmu")
    with ExitStack() as stack:
        result = five(stack, path, k=0.5)
        assert len(list(scratch.iterdir())) == len(libraries(scratch)) == count
    for i in range(5):
        assert result.trace[f"c{i}.x"].tolist() == alone(path, k=0.5 * i).trace["c.x"].tolist()


def test_python_fmus_that_share_their_folder_are_the_same_as_alone(tmp_path: Path, scratch: Path) -> None:
    path = targets.build("pendulum", tmp_path / "pendulum.fmu", target="python")
    with ExitStack() as stack:
        result = five(stack, path, angle_start=0.2)
        assert len(list(scratch.iterdir())) == 1
    for i in range(5):
        expected = alone(path, angle_start=0.2 * i).trace
        assert result.trace[f"c{i}.angle"].tolist() == expected["c.angle"].tolist()


def test_equal_files_share_a_folder_wherever_they_are_and_others_do_not(tmp_path: Path) -> None:
    source = third_party.reference(2, "Dahlquist")
    copy = Path(shutil.copy(source, tmp_path / "copy.fmu"))
    other = said_once(source, tmp_path / "other.fmu")
    with FmuFile(source) as one, FmuFile(copy) as two, FmuFile(other) as three, FmuFile(other) as four:
        assert one.folder == two.folder and (one.path, two.path) == (source, copy)
        assert len({one.folder, three.folder, four.folder}) == 3


def test_a_file_that_was_replaced_is_unpacked_anew(tmp_path: Path) -> None:
    path = Path(shutil.copy(third_party.reference(2, "Dahlquist"), tmp_path / "a.fmu"))
    with FmuFile(path) as before:
        shutil.copy(third_party.reference(2, "Stair"), path)
        with FmuFile(path) as after:
            assert before.folder != after.folder
            assert (before.interface.model_name, after.interface.model_name) == ("Dahlquist", "Stair")


@pytest.mark.slow
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.booleans(), max_size=12))
def test_the_folder_is_there_as_long_as_somebody_has_it(scratch: Path, opening: list[bool]) -> None:
    path = third_party.reference(2, "Dahlquist")
    held: list[FmuFile] = []
    for opens in opening:
        if opens:
            held.append(FmuFile(path))
        elif held:
            closed = held.pop(0)
            closed.close()
            closed.close()  # a second time is no time
        assert all((each.folder / XML).is_file() for each in held)
        assert len(list(scratch.iterdir())) == bool(held)
    for each in held:
        each.close()


def test_a_folder_that_somebody_has_removed_is_made_anew() -> None:
    path = third_party.reference(2, "Dahlquist")
    with FmuFile(path) as first:
        shutil.rmtree(first.folder)
        with FmuFile(path) as second:
            assert (second.folder / XML).is_file()
            first.close()
            assert (second.folder / XML).is_file()


@pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")
@pytest.mark.skipif(not compiler.available(), reason="no C compiler here")
def test_a_process_that_keeps_folders_loads_ours_once_for_all_that_come_one_after_the_other(
    tmp_path: Path, scratch: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(unpacked, "_keeping", True)
    own = {"viscous_friction": 0.001234}  # no other test has this file open
    ours = targets.build("pendulum", tmp_path / "pendulum.fmu", parameters=own)
    theirs = third_party.reference(2, "Dahlquist")
    first = alone(ours, angle_start=0.2).trace
    for name in ("copy", "another"):
        again = alone(Path(shutil.copy(ours, tmp_path / f"{name}.fmu")), angle_start=0.2).trace
        assert again["c.angle"].tolist() == first["c.angle"].tolist()
    alone(theirs)
    assert len(list(scratch.iterdir())) == len(libraries(scratch) - {str(theirs)}) - 1 == 1
    monkeypatch.setattr(unpacked, "_keeping", False)
    with FmuFile(ours):
        pass


def test_a_folder_can_be_given_back_by_the_thread_that_unpacks_another(monkeypatch: pytest.MonkeyPatch) -> None:
    """As the garbage collector does, which closes systems that nobody has closed wherever it runs."""
    path = third_party.reference(2, "Dahlquist")
    first, unpack = unpacked.take(path, alone=True), unpacked._unpack
    taken: list[Path] = []

    def forgetful(source: Path) -> Path:
        unpacked.give_back(first)
        return unpack(source)

    monkeypatch.setattr(unpacked, "_unpack", forgetful)
    taking = Thread(target=lambda: taken.append(unpacked.take(path, alone=True)), daemon=True)
    taking.start()
    taking.join(60)
    assert taken and not first.exists()
    unpacked.give_back(taken[0])
