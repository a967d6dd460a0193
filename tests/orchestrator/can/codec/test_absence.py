"""Where a log has no value of a signal the message says why."""

from __future__ import annotations

from pathlib import Path

import pytest

from fmus.errors import TraceError
from orchestrator.formats import Layout, read


@pytest.mark.parametrize(
    ("length", "signal", "why"),
    [
        (
            0,
            "a : 0|8@1+ (1,0)",
            "no sound signal of it, a is left out: it does not lie in the 0 bytes",
        ),
        (8, "a : 0|8@1+ (0,1,0)", "M: the database has no sound signal of it; identifiers in the log: 100"),
        (8, "a : 0|32@1- (1,0)", "M: 1 frames of 100 are too short for its 8 bytes"),
    ],
)
def test_a_message_without_sound_signals_is_told_as_such(tmp_path: Path, length: int, signal: str, why: str) -> None:
    text = f'VERSION ""\nBS_:\nBU_: A\nBO_ 256 M: {length} A\n SG_ {signal} [0|0] "" A\n'
    (tmp_path / "m.dbc").write_text(text)
    (tmp_path / "r.log").write_text("(1.0) can0 100#01\n")
    with pytest.raises(TraceError) as refused:
        read(tmp_path / "r.log", Layout(database=tmp_path / "m.dbc"))
    assert why in str(refused.value)
