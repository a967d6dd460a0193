"""Every function of native FMUs called, well and badly, under the address and undefined-behaviour sanitizers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.fmus.natives import NAMES, VERSIONS
from tests.support.fmus.sanitized import harnessed

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work


@pytest.mark.parametrize("fmi", VERSIONS)
@pytest.mark.parametrize("name", NAMES)
def test_no_call_leaves_memory_behind_or_its_bounds(
    source_fmu: Callable[[str, int], Path], tmp_path: Path, name: str, fmi: int
) -> None:
    assert harnessed(source_fmu(name, fmi), tmp_path, fmi) == (0, "")
