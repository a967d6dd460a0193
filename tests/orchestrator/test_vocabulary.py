"""What `import orchestrator` offers."""

from __future__ import annotations

import subprocess
import sys

import pytest

import orchestrator
from orchestrator.scenario.run import run_scenario


def test_every_name_is_there_and_run_is_what_the_command_does() -> None:
    assert all(getattr(orchestrator, name) is not None for name in orchestrator.__all__)
    assert orchestrator.run is run_scenario
    assert set(orchestrator.__all__) <= set(dir(orchestrator)) and set(orchestrator.__all__) == set(
        orchestrator._PLACES
    )


def test_an_unknown_name_is_no_attribute() -> None:
    with pytest.raises(AttributeError, match="module 'orchestrator' has no attribute 'unknown'"):
        orchestrator.unknown  # noqa: B018 - it raises


def test_importing_it_loads_nothing_heavy() -> None:
    code = "import sys, orchestrator; print(*({'numpy', 'pydantic', 'fmpy', 'plotly', 'pyarrow'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout == "\n"
