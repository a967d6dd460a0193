"""The C that is the same in every native FMU: the runtime, and the headers of FMI."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from fmus.files import package_folder

VERSIONS = (2, 3)
_RUNTIME = Path(__file__).parent / "c"
_COMMON = tuple(
    f"{name}{suffix}"
    for name in ("derivatives", "files", "instance", "late", "ops", "resources")
    for suffix in (".c", ".h")
)
_ADAPTERS: dict[int, tuple[str, ...]] = {2: ("fmi2.c",), 3: ("fmi3.c", "fmi3_absent.c", "fmi3_component.h")}
_SAMPLES, _NETWORK = ("fmi3_samples.c",), ("fmi3_network.c", "network.c", "network.h")
_HEADERS = {
    2: ("fmi2FunctionTypes.h", "fmi2Functions.h", "fmi2TypesPlatform.h"),
    3: ("fmi3FunctionTypes.h", "fmi3Functions.h", "fmi3PlatformTypes.h"),
}


def fixed(fmi: int, networked: bool = False) -> dict[str, str]:
    """File name -> text, for one version of FMI; `networked` with the bus of a network FMU, which FMI 3 has."""
    return dict(_fixed(fmi, networked))


@cache
def _fixed(fmi: int, networked: bool) -> dict[str, str]:
    clocks = () if fmi == 2 else _NETWORK if networked else _SAMPLES
    names = (*_COMMON, "model.h", "rules.c", *_ADAPTERS[fmi], *clocks)
    return {name: (_RUNTIME / name).read_text() for name in names} | headers(fmi)


def headers(fmi: int) -> dict[str, str]:
    """File name -> text of the headers of a version of FMI."""
    folder = package_folder("fmpy") / "c-code"
    return {name: (folder / name).read_text() for name in _HEADERS[fmi]}
