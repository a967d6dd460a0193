"""The state machine of outputs that may rest: whatever happens, it runs only on what is good."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from orchestrator.bridge.safety.resting import OutputState, OutputStatus, Rules

LOOKS = st.lists(st.tuples(st.floats(0.001, 0.3), st.booleans()), max_size=40)
RULES = st.builds(Rules, latched=st.booleans(), after=st.sampled_from([0.0, 0.1, 1.0]))


def seen(looks: list[tuple[float, bool]], rules: Rules) -> list[tuple[float, bool, OutputStatus]]:
    """(time, whether all was good, the status) of looks that are so far apart."""
    status, now, history = OutputStatus(), 0.0, []
    for gap, good in looks:
        now += gap
        status = status.seen(now, good, rules)
        history.append((now, good, status))
    return history


@given(looks=LOOKS, rules=RULES)
def test_it_rests_whenever_something_is_not_good(looks: list[tuple[float, bool]], rules: Rules) -> None:
    assert all(status.rests for _, good, status in seen(looks, rules) if not good)


@given(looks=LOOKS, rules=RULES)
def test_it_runs_from_the_first_good_look_and_again_after_a_time_of_good_ones_unless_latched(
    looks: list[tuple[float, bool]], rules: Rules
) -> None:
    since, fallen, runs = None, False, False
    for now, good, status in seen(looks, rules):
        fallen |= runs and not good
        since = (now if since is None else since) if good else None
        rested = fallen and (rules.latched or since is None or now - since < rules.after)
        runs = since is not None and (runs or not rested)
        fallen &= not runs
        assert (status.state is OutputState.RUNNING) == runs


@given(looks=LOOKS, rules=RULES)
def test_nothing_leaves_the_end(looks: list[tuple[float, bool]], rules: Rules) -> None:
    status = OutputStatus(OutputState.RUNNING, 0.0).ended()
    for gap, good in looks:
        status = status.seen(gap, good, rules)
        assert status.state is OutputState.ENDED and status.rests
