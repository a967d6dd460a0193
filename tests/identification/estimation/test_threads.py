"""Linear algebra on small matrices has one thread, and only there."""

from __future__ import annotations

import numpy as np
from threadpoolctl import threadpool_info, threadpool_limits

from identification.estimation.threads import single_threaded


def threads() -> list[int]:
    np.linalg.qr(np.eye(3))
    return [library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"]


@single_threaded
def inside(answer: int) -> tuple[int, list[int]]:
    return answer, threads()


def test_a_function_runs_with_one_thread_and_leaves_the_others_theirs() -> None:
    with threadpool_limits(2, user_api="blas"):
        assert set(threads()) == {2}, "or nothing below would be a claim"
        answer, within = inside(answer=7)
        assert answer == 7
        assert set(within) == {1}
        assert set(threads()) == {2}
