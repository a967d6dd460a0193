"""A native FMU, version 2.0 or 3.0, that crashes, hangs or breaks off on request: `mood` says how, `at` from when on.

It is a first-order lag, level' = flow - level, whose steps go through `brute.c`.
"""

from __future__ import annotations

from enum import IntEnum
from pathlib import Path

import pytest

from fmus.modelling.model import Model, State, input_, output, parameter
from fmus.packaging import archive, targets
from fmus.packaging.native import compiler

Mood = IntEnum(
    "Mood", "SEGMENTATION ABORT EXIT HANG PRINT DEAF GARBAGE ORPHAN LAST_WORDS BAD_END"
)  # as in brute.c, where 0 is calm

MODEL = Model(
    "brute",
    "A lag that misbehaves",
    (
        input_("flow", "1", "Flow in"),
        output("level", "1", "Level"),
        parameter("mood", "1", 0, "How it misbehaves"),
        parameter("at", "s", 0.5, "When it begins to"),
    ),
    states=(State("level"),),
    derivatives=lambda t, x, u, p: {"level": u.flow - x.level},
    solver_step=lambda p: 0.1,
)


def build(path: Path, version: int = 2, flags: tuple[str, ...] = ()) -> Path:
    """The FMU at this path; the test is skipped where there is no C compiler."""
    if not compiler.available():
        pytest.skip("there is no C compiler to build the misbehaving FMU with")
    targets.build(MODEL, path, fmi=version, target="native")
    with archive.opened(path) as zipped:
        files = {name: zipped.read(name) for name in zipped.namelist()}
    sources = {Path(name).name: text.decode() for name, text in files.items() if name.endswith((".c", ".h"))}
    adapter = f"fmi{version}.c"
    for function in ("step", "close"):
        assert f"instance_{function}(of(" in sources[adapter]
        sources[adapter] = sources[adapter].replace(f"instance_{function}(of(", f"brute_{function}(of(")
    declared = "Status brute_step(Instance *, double, double);\nvoid brute_close(Instance *);\n"
    sources[adapter] = sources[adapter].replace('#include "instance.h"', f'#include "instance.h"\n{declared}')
    sources["brute.c"] = Path(__file__).with_name("brute.c").read_text()
    (binary,) = [name for name in files if name.startswith("binaries/")]
    files[binary] = compiler.compile_library(sources, "brute", compiler.host(), flags)
    archive.write(path, files)
    return path
