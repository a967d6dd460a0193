"""State feedback from an observer, with feed-forward of the reference and an integral of the position's error.

    voltage = kp reference + integral - K x,   x[k+1] = A x[k] + B voltage[k] + L (measured[k] - C x[k])

The first of what is measured is the position. The observer is given the command within its limits, and runs while the
controller is not enabled, too. The file travels inside every Python FMU.
"""

from collections.abc import Sequence
from typing import Any

from . import control, ops
from .model import Named, State, Variable, array


def parameters(order: int, sensors: int) -> tuple[Variable, ...]:
    """Matrices of a model of this order with one input, and the gains; all zero."""
    sizes = {"A": (order, order), "B": (order, 1), "C": (sensors, order), "K": (1, order), "L": (order, sensors)}
    words = {"K": "Gains of the state feedback, which is subtracted", "L": "Gains of the observer (predicting form)"}
    return (
        *(one for name, size in sizes.items() for one in array(name, "1", size, words.get(name, f"Matrix {name}"))),
        *array("x_start", "1", (order,), "State of the observer at the start"),
    )


def states(order: int) -> tuple[State, ...]:
    return (
        *control.STATES,
        control.INTEGRAL,
        State("estimate", 0.0, "V", sampled=True),
        *(State(f"x_{i}", f"x_start[{i}]", sampled=True) for i in range(1, order + 1)),
    )


def update(measured: Sequence[Any], x: Any, u: Any, p: Any) -> Named:
    """New values of the states."""
    observed = [getattr(x, f"x_{i}") for i in range(1, len(p.A) + 1)]
    [gains] = p.K
    rest = p.kp * u.reference - ops.dot(gains, observed)
    integral = control.integral(rest, p.ki * p.sample_time * (u.reference - measured[0]), x, u, p)
    given = control.command(rest + integral, u.manual, x, u, p) | {"integral": integral}
    expected = [ops.dot(row, observed) for row in p.C]
    surprise = [found - told for found, told in zip(measured, expected, strict=True)]
    for i, (a, b, gain) in enumerate(zip(p.A, p.B, p.L, strict=True), start=1):
        given[f"x_{i}"] = ops.dot(a, observed) + b[0] * given["voltage"] + ops.dot(gain, surprise)
    return given | {"estimate": expected[0]}
