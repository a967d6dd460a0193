"""How many states a model gets: given, or read from singular values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fmus.errors import IdentificationError
from identification.linear.records import InputOutputData
from orchestrator.trace import FloatArray

_ZERO = 1e-12  # of the largest singular value


@dataclass(frozen=True)
class Threshold:
    """As many states as singular values exceed `relative` times the largest (thesis, Eq. 2-22)."""

    relative: float = 1e-3


@dataclass(frozen=True)
class Gap:
    """The order from `least` to `most` after which the singular values fall by the largest factor."""

    least: int = 1
    most: int = 40


@dataclass(frozen=True, eq=False)
class Best:
    """The smallest of `orders` whose free-run error is within `margin` of the least.

    Attributes:
        margin: relative; 0.01 prefers a smaller order that is at most 1 % worse.
        validation: records to judge by; those that were fitted when there are none.
    """

    orders: Sequence[int]
    margin: float = 0.01
    validation: Sequence[InputOutputData] = ()


OrderRule = int | Threshold | Gap | Best


def borne(values: FloatArray, limit: int) -> int:
    """The largest order the data bear: singular values above rounding, and no more than `limit`."""
    return min(int(np.count_nonzero(values > _ZERO * values.max(initial=0.0))), limit)


def checked(order: int, values: FloatArray, limit: int) -> int:
    """The order.

    Raises:
        IdentificationError: it is not positive, beyond what the block size can determine, or beyond the data's rank.
    """
    if order < 1:
        raise IdentificationError("order", f"{order} is not positive", "ask for at least one state")
    if order > limit:
        raise IdentificationError(
            "order", f"{order} is more than the {limit} states that this block size determines", "use a larger block"
        )
    if order > borne(values, limit):
        raise IdentificationError(
            "order", f"the data bear no more than {borne(values, limit)} states, not {order}", "ask for fewer"
        )
    return order


def from_singular_values(rule: int | Threshold | Gap, values: FloatArray, limit: int) -> tuple[int, str]:
    """The order by a rule, and why.

    Args:
        values: (r,) falling.
        limit: the most states that A can be solved for.
    """
    if isinstance(rule, Threshold):
        order = max(1, min(int(np.count_nonzero(values > rule.relative * values[0])), borne(values, limit)))
        return order, f"{order} singular values exceed {rule.relative:g} of the largest"
    if isinstance(rule, Gap):
        return _gap(rule, values, borne(values, limit))
    return checked(rule, values, limit), f"order {rule} was asked for"


def _gap(rule: Gap, values: FloatArray, most: int) -> tuple[int, str]:
    if not 1 <= rule.least <= min(rule.most, most):
        raise IdentificationError("order", f"no order from {rule.least} to {min(rule.most, most)}", "widen the range")
    orders = np.arange(rule.least, min(rule.most, most) + 1)
    following = np.append(values, 0.0)[orders]
    ratios = values[orders - 1] / np.maximum(following, _ZERO * values[0])
    best = int(np.argmax(ratios))
    why = f"singular values fall by {ratios[best]:.3g} after {orders[best]}, most of {orders[0]} to {orders[-1]}"
    return int(orders[best]), why
