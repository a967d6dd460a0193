"""What an input was earlier, for models whose inputs act late (`model.Delay`).

What acts is a sum of the values that were set, each with a weight, so that tangents are carried by the same weights.
The file travels inside every Python FMU.
"""

from typing import Any

LONGEST = 1024  # steps within a delay
Row = tuple[float, float]  # from when on, and its value


def acting(rows: list[Row], start: float, stop: float, before: float, smooth: bool) -> float:
    """What acts between these instants [s], by the values (oldest first) that hold from theirs on."""
    weights, share = curve_weights(rows, stop) if smooth else mean_weights(rows, start, stop)
    total = share * before
    for (_, value), weight in zip(rows, weights, strict=True):
        total += weight * value
    return total


def mean_weights(rows: list[Row], start: float, stop: float) -> tuple[list[float], float]:
    """How long each value holds between two instants, and how long none does yet (the first holds then, too, over what
    was `before`); parts of the whole."""
    if not stop > start:
        last = max((i for i, (time, _) in enumerate(rows) if time <= start), default=0)
        return [float(i == last) for i in range(len(rows))], float(start < rows[0][0])
    weights = []
    for i, (time, _) in enumerate(rows):
        begins = start if i == 0 else max(time, start)
        ends = stop if i + 1 == len(rows) else min(rows[i + 1][0], stop)
        weights.append(max(ends - begins, 0.0) / (stop - start))
    return weights, max(min(rows[0][0], stop) - start, 0.0) / (stop - start)


def curve_weights(rows: list[Row], instant: float) -> tuple[list[float], float]:
    """Of the cubic through the values around an instant, with slopes by parabolas; the first one before all."""
    count = len(rows)
    weights = [0.0] * count
    if count == 1 or instant <= rows[0][0]:
        weights[0] = 1.0
        return weights, 0.0
    left = min(max(i for i, (time, _) in enumerate(rows) if time <= instant), count - 2)
    width = rows[left + 1][0] - rows[left][0]
    s = (instant - rows[left][0]) / width
    weights[left] += (1 + 2 * s) * (1 - s) * (1 - s)
    weights[left + 1] += s * s * (3 - 2 * s)
    _add_slope(weights, rows, left, width * s * (1 - s) * (1 - s))
    _add_slope(weights, rows, left + 1, width * s * s * (s - 1))
    return weights, 0.0


def _add_slope(weights: list[float], rows: list[Row], at: int, factor: float) -> None:
    """Add a factor times the weights of the slope there: of the parabola through three values, a line through two."""
    size = min(3, len(rows))
    first = min(max(at - 1, 0), len(rows) - size)
    nodes = [rows[first + i][0] for i in range(size)]
    for i, node in enumerate(nodes):
        others = [other for j, other in enumerate(nodes) if j != i]
        slope = sum(rows[at][0] - other for other in others) if size == 3 else 1.0
        for other in others:
            slope /= node - other
        weights[first + i] += factor * slope


class History:
    """The values of one input, as far back as they still act.

    Attributes:
        rows: the values, oldest first, with the instants at which steps began with them.
        acts: what acts over the latest step.
    """

    def __init__(self) -> None:
        self.rows: list[Row] = []
        self.acts = 0.0

    def push(self, time: float, value: float, delay: float) -> bool:
        """Note that a step begins with this value; False where the delay holds too many."""
        while len(self.rows) > 2 and self.rows[2][0] <= time - delay:
            del self.rows[0]
        if self.rows and self.rows[-1][0] >= time:
            del self.rows[-1]
        self.rows.append((time, value))
        return len(self.rows) <= LONGEST

    def with_last(self, time: float, value: float) -> list[Row]:
        """The values as they would be if a step began with this one."""
        rows = self.rows[:-1] if self.rows and self.rows[-1][0] >= time else self.rows
        return [*rows, (time, value)]

    def snapshot(self) -> Any:
        """Everything, for `restore`."""
        return list(self.rows), self.acts

    def restore(self, state: Any) -> None:
        """Go back to a snapshot."""
        rows, self.acts = state
        self.rows = list(rows)
