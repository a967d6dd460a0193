"""Blocks that commands print are read as they were meant, whatever the names in them."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from ruamel.yaml import YAML

from orchestrator.display.block import block

NAMES = st.text(st.characters(exclude_categories=["Cs"])) | st.sampled_from(
    ["on", "1e3", "~", "<<", "=", "a: b", "a #b"]
)
VALUES = NAMES | st.integers() | st.booleans() | st.none()


@pytest.mark.slow
@given(st.dictionaries(NAMES, VALUES | st.dictionaries(NAMES, VALUES)))
@example({"n" * 2000: {"Null": "x" * 2000}, "µs": "°C", "time [s]": "U / V", "0x1": "1_0", "\U0001f600\x85": "\ufeff"})
def test_a_block_is_read_as_it_was_meant(values: dict[str, object]) -> None:
    assert (YAML(typ="safe", pure=True).load(block(values)) or {}) == values
