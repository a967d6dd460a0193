"""The right one of five friction laws is chosen, on fewer draws than the benchmark takes."""

from __future__ import annotations

import pytest
from scipy import stats

from tests.support.identification.friction_laws import choices, draws

DRAWS = 40
LEAST = int(stats.binom.ppf(1e-3, DRAWS, 0.95))


@pytest.mark.slow
@pytest.mark.shipped
def test_the_right_friction_law_is_chosen_as_often_as_asked() -> None:
    asked = draws(DRAWS)
    found = choices(asked, 1)
    right = sum(law == chosen for (law, _), chosen in zip(asked, found, strict=True))
    assert right >= LEAST, [(law, chosen) for (law, _), chosen in zip(asked, found, strict=True) if law != chosen]
