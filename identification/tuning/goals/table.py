"""All measures by name."""

from __future__ import annotations

from identification.tuning.goals import margins, noise, poles, responses
from identification.tuning.goals.goal import Measure

MEASURES: dict[str, Measure] = {
    **margins.MEASURES,
    **responses.MEASURES,
    **poles.MEASURES,
    **noise.MEASURES,
}
