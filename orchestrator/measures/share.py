"""What a share of runs or draws tells of all such."""

from __future__ import annotations

SURE = 0.95


def share_interval(held: int, count: int) -> tuple[float, float]:
    """Within which the share of all such lies, 95 % sure, where `held` of `count` independent ones are counted.

    Source: Clopper and Pearson 1934, exact for the binomial distribution.
    """
    from scipy.special import betaincinv  # noqa: PLC0415 - loads slowly

    low = float(betaincinv(held, count - held + 1, (1 - SURE) / 2)) if held else 0.0
    high = float(betaincinv(held + 1, count - held, (1 + SURE) / 2)) if held < count else 1.0
    return low, high


def chance_of_fewer(needed: int, count: int, share: float) -> float:
    """How likely fewer than `needed` of `count` independent ones hold, each of which does with the chance `share`."""
    from scipy.special import bdtr  # noqa: PLC0415 - loads slowly

    return float(bdtr(needed - 1, count, share))
