"""What a stream of frames had wrong with it is counted and told."""

from __future__ import annotations

import json

from orchestrator.can.statistics import MOST, FrameStatistics


def test_a_flood_of_unknown_identifiers_is_counted_in_bounded_memory() -> None:
    statistics = FrameStatistics()
    for identifier in range(3 * MOST):
        statistics.add_unknown(identifier, True)
    assert len(statistics.unknown) == MOST + 1
    assert statistics.unknown.total() == 3 * MOST
    assert statistics.unknown["others"] == 2 * MOST


def test_the_census_is_a_line_for_each_kind_of_trouble_and_a_document_of_it_all() -> None:
    statistics = FrameStatistics(frames=10, errors=2)
    assert statistics.lines() == ["error frames: 2"]
    statistics.messages["State"] += 8
    statistics.missing.update(State=3, Command=1)
    statistics.add_setback(7, 5.0, 1.0)
    assert statistics.lines()[0] == "frames missing (estimated): 4 (State 3, Command 1)"
    assert not statistics.clean
    assert json.loads(json.dumps(statistics.document())) == {
        "frames": 10,
        "messages": {"State": 8},
        "errors": 2,
        "missing": {"State": 3, "Command": 1},
        "setback_count": 1,
        "setbacks": [{"frame": 7, "before": 5.0, "after": 1.0}],
    }
