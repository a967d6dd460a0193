"""Whatever holds FMUs, packed or unpacked, is shown with all that is inside."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

from fmus.errors import FmuFileError
from fmus.packaging import archive as archives
from orchestrator.ssp.tree import DEEPEST, tree
from tests.support.commands import servotwin
from tests.support.simulation.ssps import archive, component, gain, system


def container(folder: Path) -> Path:
    """An FMU with one packed and one unpacked in its resources, as containers of other tools have them."""
    own = archives.read(gain())
    outer = own["modelDescription.xml"].replace(b'modelName="gain"', b'modelName="container"')
    unpacked = {f"resources/one/{name}": content for name, content in own.items()}
    files = {"modelDescription.xml": outer, "resources/two.fmu": gain().read_bytes(), **unpacked}
    archives.write(folder / "container.fmu", files)
    return folder / "container.fmu"


def test_a_container_in_an_ssp_is_shown_with_what_it_holds(tmp_path: Path) -> None:
    files = {"resources/box.fmu": container(tmp_path), "resources/gain.fmu": gain()}
    ssp = archive(tmp_path / "s.ssp", system([component("a"), component("b", "resources/box.fmu")]), files)
    assert list(tree(ssp).lines()) == [
        str(ssp),
        "  resources/box.fmu: container, FMI 2.0",
        "    resources/one: gain, FMI 2.0",
        "    resources/two.fmu: gain, FMI 2.0",
        "  resources/gain.fmu: gain, FMI 2.0",
    ]
    shown = servotwin("info", ssp, "--tree")
    assert shown.exit_code == 0 and "resources/one: gain, FMI 2.0" in shown.stdout


def test_archives_without_end_and_broken_ones_inside_are_refused(tmp_path: Path) -> None:
    inner = gain()
    for number in range(DEEPEST + 1):
        with zipfile.ZipFile(tmp_path / f"{number}.fmu", "w") as made:
            made.write(inner, "resources/inner.fmu")
        inner = tmp_path / f"{number}.fmu"
    with pytest.raises(FmuFileError, match=f"more than {DEEPEST} archives deep") as refused:
        tree(inner)
    assert str(refused.value).startswith(str(inner))
    with zipfile.ZipFile(tmp_path / "broken.fmu", "w") as made:
        made.writestr("resources/inner.fmu", "no zip")
    with pytest.raises(FmuFileError, match=r"broken\.fmu: resources/inner\.fmu: is not a zip"):
        tree(tmp_path / "broken.fmu")
