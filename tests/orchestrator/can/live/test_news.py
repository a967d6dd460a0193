"""What is not as it should be is said at once, and then less and less often, with nothing left out."""

from __future__ import annotations

import itertools
import pickle
from collections import Counter

import can
from hypothesis import given
from hypothesis import strategies as st

from orchestrator.can.live.news import ErrorStates, News
from orchestrator.progress import Figures


def test_it_is_said_at_once_and_then_ever_less_often() -> None:
    said: list[tuple[float, str]] = []
    now, counts = 0.0, Counter[str]()
    news = News(lambda line: said.append((now, line)))
    while now < 1000:
        news.look(now, lambda: counts)
        counts["error frames"] += 100 < now < 900
        now += 0.5
    times = [time for time, _ in said]
    assert times[0] < 101.1 and len(said) < 25
    assert max(after - before for before, after in itertools.pairwise(times)) <= 62
    assert sum(int(line.split()[0]) for _, line in said) == counts.total()


@given(st.lists(st.tuples(st.floats(0, 100), st.sampled_from(["a", "b"])), max_size=30))
def test_nothing_is_left_out(events: list[tuple[float, str]]) -> None:
    said: list[str] = []
    counts, told, now = Counter[str](), Counter[str](), 0.0
    news = News(said.append)
    for wait, what in events:
        now += wait
        counts[what] += 1
        news.look(now, lambda: counts)
    news.look(now + 200, lambda: counts)
    for part in ", ".join(said).split(", ") if said else []:
        told[part.split()[1]] += int(part.split()[0])
    assert told == counts


def test_states_of_an_adapter_are_counted_by_their_bits() -> None:
    states = ErrorStates()
    for bits in (0x0C, 0x30, 0x30, 0x40, 0x01):
        states.add([can.Message(arbitration_id=0x204, is_error_frame=True, dlc=8, data=bytes([0, bits, *bytes(6)]))])
    states.add([can.Message(arbitration_id=0x204, is_extended_id=False, data=bytes(8))])
    assert +states.counts == {
        "changes to error warning": 1,
        "changes to error passive": 2,
        "overflows of the adapter": 1,
    }


def test_a_line_with_figures_passes_between_processes() -> None:
    figures = pickle.loads(pickle.dumps(Figures.of("3 frames", {"frames": 3})))
    assert figures == "3 frames" and figures.values == {"frames": 3} and isinstance(figures, Figures)
