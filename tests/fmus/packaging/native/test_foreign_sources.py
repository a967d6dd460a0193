"""FMUs that bring sources along are compiled when somebody asks for it, and then do what their own binaries do."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from fmus.errors import FmuError, FmuFileError, ServotwinError
from fmus.packaging import archive, targets
from fmus.packaging.native import compiler, foreign_sources
from orchestrator.assembly.wiring import wire
from orchestrator.engine import Simulation, Timing
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.slave import Slave
from orchestrator.system import Part
from orchestrator.trace import Trace
from tests.support.fmus import moody
from tests.support.tools import third_party

XML, BUILD = "modelDescription.xml", "sources/buildDescription.xml"


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("SERVOTWIN_CACHE", str(tmp_path / "cache"))
    yield tmp_path / "cache"


@pytest.fixture
def needs_compiler() -> None:
    if not compiler.available():
        pytest.skip("no C compiler here")


def without_binaries(source: Path, target: Path, **changed: bytes) -> Path:
    files = {name: content for name, content in archive.read(source).items() if not name.startswith("binaries/")}
    archive.write(target, files | changed)
    return target


def trace(path: Path) -> Trace:
    with FmuFile(path) as file:
        system = wire({"c": Part(file.interface)}, [])
        with Simulation(system, {"c": Slave(file, "c")}, Timing(Fraction(3), Fraction(1))) as made:
            return made.run().trace


def same(one: Trace, other: Trace) -> bool:
    return one.names == other.names and all(np.allclose(one[n], other[n], rtol=1e-12, atol=0) for n in one.names)


@pytest.mark.slow
@pytest.mark.parametrize(("fmi", "model"), [(2, "Dahlquist"), (3, "StateSpace"), (2, "pendulum"), (3, "pendulum")])
def test_the_original_runs_once_its_sources_were_compiled_and_as_its_binary_does(
    fmi: int, model: str, tmp_path: Path, needs_compiler: None
) -> None:
    """Functions of sources have the model's name in front of theirs, by a macro of their own."""
    if model == "pendulum":
        whole = targets.build(model, tmp_path / "whole.fmu", target="native", fmi=fmi)
    else:
        whole = third_party.reference(fmi, model)
    bare = without_binaries(whole, tmp_path / "bare.fmu")
    content = bare.read_bytes()
    with pytest.raises(FmuFileError, match=r"it has: none.*compile its sources: servotwin build --from-sources .*bare"):
        FmuFile(bare)
    notes = foreign_sources.build(bare, tmp_path / "out" / "bare.fmu")
    assert bare.read_bytes() == content
    assert notes == (
        ("its build description is for 'LinearTransform'; taken for StateSpace",)
        if fmi == 3 and model != "pendulum"
        else ()
    )
    expected = trace(whole)
    assert same(trace(tmp_path / "out" / "bare.fmu"), expected)
    assert same(trace(bare), expected)


def listed(text: str) -> bytes:
    entry = (
        f'<BuildConfiguration modelIdentifier="StateSpace"><SourceFileSet {text}</SourceFileSet></BuildConfiguration>'
    )
    return f'<?xml version="1.0"?><fmiBuildDescription fmiVersion="3.0">{entry}</fmiBuildDescription>'.encode()


def files(changed: Mapping[str, bytes]) -> dict[str, bytes]:
    return {**archive.read(third_party.reference(3, "StateSpace")), **changed}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('><SourceFile name="../model.c"/>', "lists the source '../model.c', which it does not hold"),
        ('><SourceFile name="/etc/passwd"/>', "lists the source '/etc/passwd', which it does not hold"),
        ('><SourceFile name="-fplugin=x.so"/>', "lists the source '-fplugin=x.so', which it does not hold"),
        ('><SourceFile name="model.c"/><PreprocessorDefinition name="A -o x"/>', "is no name of a macro"),
    ],
)
def test_a_list_of_sources_that_cannot_be_true_is_refused(text: str, problem: str) -> None:
    with pytest.raises(ServotwinError) as refused:
        foreign_sources.described(Path("x.fmu"), files({BUILD: listed(text)}))
    assert problem in str(refused.value)


@pytest.mark.slow
def test_definitions_folders_and_language_are_the_fmus_own() -> None:
    text = """language="C99" compiler="gcc" compilerOptions="-mavx"><SourceFile name="./model.c"/>
      <PreprocessorDefinition name="A"/><PreprocessorDefinition name="B" value="1 2"/>
      <PreprocessorDefinition name="C" optional="true"/><IncludeDirectory name="below"/>"""
    found = foreign_sources.described(Path("x.fmu"), files({BUILD: listed(text)}))
    (part,) = found.libraries["StateSpace"]
    assert part == foreign_sources.SourceFiles(("model.c",), ("-DA", "-DB=1 2", "-std=gnu99"), ("below",))
    assert found.notes == ("the options '-mavx' for gcc are left out",)


def test_what_is_not_listed_is_found_and_told() -> None:
    source = archive.read(third_party.reference(2, "Dahlquist"))
    source[XML] = source[XML].replace(b'<File name="all.c"/>', b"")
    found = foreign_sources.described(Path("x.fmu"), source)
    assert found.libraries["Dahlquist"][0].files == ("all.c",)
    assert found.notes == ("it does not say what to compile; taken: all.c",)
    with pytest.raises(FmuFileError, match="brings no sources along"):
        foreign_sources.described(Path("x.fmu"), {n: c for n, c in source.items() if not n.startswith("sources/")})


@pytest.mark.slow
def test_what_does_not_compile_is_told_with_the_compilers_reason(tmp_path: Path, needs_compiler: None) -> None:
    broken = without_binaries(
        third_party.reference(3, "StateSpace"), tmp_path / "broken.fmu", **{"sources/model.c": b"int a = ;"}
    )
    with pytest.raises(ServotwinError, match=r"broken\.fmu, .*model\.c:1.*error"):
        foreign_sources.build(broken, tmp_path / "out.fmu")
    assert not (tmp_path / "out.fmu").exists()


def test_the_original_is_not_replaced(tmp_path: Path) -> None:
    bare = without_binaries(third_party.reference(3, "StateSpace"), tmp_path / "bare.fmu")
    with pytest.raises(FmuFileError, match="would be replaced; give another folder with --out"):
        foreign_sources.build(bare, bare)


@pytest.mark.slow
def test_a_library_from_sources_is_loaded_anew_after_a_fatal_error(tmp_path: Path, needs_compiler: None) -> None:
    source = Path(moody.__file__).with_name("moody.c").read_bytes()
    bare = without_binaries(moody.build(tmp_path), tmp_path / "bare.fmu", **{"sources/moody.c": source})
    foreign_sources.build(bare, tmp_path / "out.fmu")
    with FmuFile(bare) as file:
        slave = Slave(file, "c")
        for status in (4, 4, 0):  # a first death costs the instance, another one the library
            slave.set({"step": status})
            slave.begin(0.0, None)
            slave.run()
            if status:
                with pytest.raises(FmuError, match="fatal"):
                    slave.step(0.0, 0.1)
                slave.reset()
            else:
                slave.step(0.0, 0.1)
        slave.close()
