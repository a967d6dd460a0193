"""How late things were done that have a deadline: percentiles of any number of them, in bounded memory."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

_FINEST, _PER_DECADE = 1e-6, 50  # the smallest lateness that is told apart [s]; steps of 4.7 %
_BINS = 9 * _PER_DECADE  # up to 1000 s


@dataclass
class Lateness:
    """Counts by lateness."""

    count: int = 0
    worst: float = 0.0
    _bins: list[int] = field(default_factory=lambda: [0] * (_BINS + 1))

    def add(self, seconds: float) -> None:
        """Count one that was so late; early ones count as on time."""
        self.count += 1
        self.worst = max(self.worst, seconds)
        place = math.ceil(math.log10(seconds / _FINEST) * _PER_DECADE) if seconds > _FINEST else 0
        self._bins[min(place, _BINS)] += 1

    def quantile(self, share: float) -> float:
        """The lateness that this share does not exceed, rounded up by 4.7 % at most [s]."""
        left = math.ceil(share * self.count)
        for place, count in enumerate(self._bins):
            left -= count
            if left <= 0:
                return min(_FINEST * 10 ** (place / _PER_DECADE), self.worst)
        return self.worst

    @property
    def figures(self) -> dict[str, float]:
        """Percentiles by their names, for manifests [s]."""
        shares = {"median": 0.5, "p95": 0.95, "p99": 0.99, "p99_9": 0.999}
        return {**{name: self.quantile(share) for name, share in shares.items()}, "worst": self.worst}

    def bins(self) -> list[tuple[float, float, int]]:
        """Lower end, upper end [s] and count of each bin from the first to the last that holds any."""
        filled = [place for place, count in enumerate(self._bins) if count]
        ends = [0.0, *(_FINEST * 10 ** (place / _PER_DECADE) for place in range(_BINS + 1))]
        return (
            [(ends[place], ends[place + 1], self._bins[place]) for place in range(filled[0], filled[-1] + 1)]
            if filled
            else []
        )
