"""What would take more memory than there is, is refused with the figures before it takes any."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from fmus.errors import InputError
from orchestrator import formats
from orchestrator.processes import memory

GIGABYTE = 1e9


def test_only_what_does_not_fit_is_refused_and_the_figures_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "available", lambda: GIGABYTE)
    memory.require("a.csv", "all", GIGABYTE, "cut it")
    with pytest.raises(InputError, match=r"^a.csv: all would take 1.5 GB of memory, 1 GB are there; cut it$"):
        memory.require("a.csv", "all", 1.5 * GIGABYTE, "cut it")
    assert memory.available() > 0


def test_a_small_file_of_many_samples_is_refused_before_they_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    count = 1_200_000
    table = pa.table({"time": np.arange(count, dtype=float), "a": np.zeros(count)})
    parquet.write_table(table, tmp_path / "many.parquet", compression="zstd")
    monkeypatch.setattr(memory, "available", lambda: 5e7)
    with pytest.raises(InputError, match=r"1,200,000 samples would take 0.0768 GB.*fewer `columns`"):
        formats.read(tmp_path / "many.parquet")
