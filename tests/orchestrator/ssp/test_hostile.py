"""An SSP that is damaged or means harm ends in one line with the place and the fix, and leaves nothing."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import FmuFileError, InputError
from orchestrator.scenario.exchange import unpack
from orchestrator.ssp.checking import check
from orchestrator.ssp.document import imported
from tests.support.simulation.ssps import XMLNS, archive, bindings, component, connection, gain, real, system, values

BOMB = f'<!DOCTYPE b [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;">]><ssv:ParameterSet {XMLNS}>&b;</ssv:ParameterSet>'


def sourced(source: str, kind: str = "application/x-fmu-sharedlibrary") -> str:
    return system([f'<ssd:Component name="a" type="{kind}" source="{source}"/>'])


def bound(more: str) -> str:
    inner = f"<ssd:ParameterBindings><ssd:ParameterBinding {more}/></ssd:ParameterBindings>"
    return system([component("a", inner=inner)])


def linked(inner: str, more: str = "") -> str:
    return system(map(component, "ab"), [connection("a.y", "b.u", inner, more)])


def valued(element: str) -> str:
    return system([component("a", inner=bindings(values({"k": element})))])


def test_many_archives_are_read_without_holding_on_to_anything(tmp_path: Path) -> None:
    open_files, held = Path("/proc/self/fd"), set()
    for number in range(12):
        imported(archive(tmp_path / "s.ssp", system([component("a")], name=f"top{number}")))
        held.add(len([*open_files.iterdir()]) if open_files.is_dir() else 0)
    assert len(held) == 1


@pytest.mark.parametrize(
    ("described", "problem"),
    [
        (sourced("../../../etc/passwd"), "leaves the archive.*do not trust it"),
        (sourced("resources/%2e%2e/%2e%2e/secret"), "leaves the archive"),
        (sourced("/etc/passwd"), "leaves the archive"),
        (sourced("file:///etc/passwd"), "no file of the archive"),
        (sourced("https://example.org/a.fmu"), "no file of the archive"),
        (sourced("resources/none.fmu"), "which is not in the archive"),
        (sourced("SystemStructure.ssd"), "not a zip|is not a zip"),
        (sourced("SystemStructure.ssd", "application/x-ssp-definition"), "is a system within itself"),
        (sourced("resources/gain.fmu", "text/x-modelica"), "which cannot be run"),
        (system(['<ssd:Component name="a"/>']), "has no source"),
        (system([component("a"), component("a")]), "holds 'a' twice"),
        (bound('source="resources/bomb.ssv"'), "declares a document type"),
        (bound('source="../up.ssv"'), "leaves the archive|not in the archive"),
        (bound('type="text/csv" source="resources/bomb.ssv"'), "convert them"),
        (bound(""), "without source and contents"),
        (linked('<ssc:LinearTransformation factor="NaN"/>'), "is no number"),
        (linked('<ssc:LinearTransformation factor="1e999"/>'), "is no number"),
        (linked("<ssc:BooleanMappingTransformation/>"), "without entries"),
        (linked("", 'suppressUnitConversion="perhaps"'), "is no truth"),
        (valued('<ssv:Real value="two"/>'), "'two' is no Real"),
        (valued('<ssv:Real value="INF"/>'), "'INF' is no Real"),
        (valued('<ssv:Integer value="1.5"/>'), "'1.5' is no Integer"),
        (valued('<ssv:Quaternion value="1"/>'), "is no Quaternion"),
        (valued(""), "has no value"),
    ],
)
def test_a_system_that_cannot_be_is_refused_in_one_line(tmp_path: Path, described: str, problem: str) -> None:
    path = archive(tmp_path / "x.ssp", described, {"resources/gain.fmu": gain(), "resources/bomb.ssv": BOMB})
    with pytest.raises(InputError, match=problem) as refused:
        unpack(path, tmp_path / "out")
    assert str(refused.value).startswith(str(path))
    assert len(str(refused.value).splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_what_is_no_ssp_is_refused(tmp_path: Path) -> None:
    whole = archive(tmp_path / "whole.ssp", system([component("a")]))
    (tmp_path / "half.ssp").write_bytes(whole.read_bytes()[:-300])
    (tmp_path / "text.ssp").write_text("title: a scenario")
    with zipfile.ZipFile(tmp_path / "empty.ssp", "w") as made:
        made.writestr("other.ssd", "")
    with zipfile.ZipFile(tmp_path / "climbing.ssp", "w") as made:
        made.writestr("../SystemStructure.ssd", "")
    version = archive(tmp_path / "future.ssp", system([component("a")]), version="9.0")
    for name in ("half", "text", "empty", "climbing", "gone"):
        with pytest.raises(FmuFileError):
            imported(tmp_path / f"{name}.ssp")
    with pytest.raises(FmuFileError, match=r"SSP version '9\.0'"):
        imported(version)


def test_a_bomb_is_not_unpacked(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "bomb.ssp", "w", zipfile.ZIP_DEFLATED) as made:
        made.writestr("SystemStructure.ssd", b" " * (80 << 20))
    with pytest.raises(FmuFileError, match=r"times its size.*do not trust it"):
        imported(tmp_path / "bomb.ssp")


def test_systems_nested_without_end_are_refused(tmp_path: Path) -> None:
    depth = 400
    text = "".join(f'<ssd:System name="s{n}"><ssd:Elements>' for n in range(depth)) + component("a")
    path = archive(tmp_path / "deep.ssp", text + "</ssd:Elements></ssd:System>" * depth)
    with pytest.raises(FmuFileError, match="is not XML"):
        imported(path)
    inner = archive(tmp_path / "0.ssp", system([component("a")]))
    for number in range(1, 25):
        files = {"inner.ssp": inner}
        inner = archive(tmp_path / f"{number}.ssp", sourced("inner.ssp", "application/x-ssp-package"), files)
    with pytest.raises(FmuFileError, match="more than 20 files deep"):
        imported(inner)


@pytest.mark.slow
@given(place=st.floats(0, 1), new=st.binary(min_size=0, max_size=12), length=st.integers(0, 30))
def test_a_description_changed_anywhere_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, place: float, new: bytes, length: int
) -> None:
    folder = tmp_path_factory.getbasetemp()
    chain = system(
        [component("a", inner=bindings(values({"k": real(3)}))), component("b")],
        [connection("a.y", "b.u", '<ssc:LinearTransformation factor="2"/>')],
    )
    with zipfile.ZipFile(archive(folder / "sound.ssp", chain)) as sound:
        text = sound.read("SystemStructure.ssd")
    at = int(place * len(text))
    with zipfile.ZipFile(folder / "changed.ssp", "w") as made:
        made.writestr("SystemStructure.ssd", text[:at] + new + text[at + length :])
        made.write(gain(), "resources/gain.fmu")
    try:
        imported(folder / "changed.ssp")
    except InputError as refused:
        assert re.match(r"\S+changed\.ssp", str(refused))


def test_a_check_names_the_line_of_what_the_schema_does_not_know(tmp_path: Path) -> None:
    odd = system([component("a", inner="<ssd:Surprise/>")])
    found = check(archive(tmp_path / "odd.ssp", odd))
    assert [problem.file for problem in found.problems] == ["SystemStructure.ssd"]
    assert "Surprise" in found.problems[0].problem and found.problems[0].problem.startswith("line 1")
