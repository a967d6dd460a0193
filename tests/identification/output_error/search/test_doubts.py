"""What a reader of estimates is warned of."""

from __future__ import annotations

import numpy as np
import pytest

from fmus.errors import FmuError
from identification.estimation.parameters import Parameter
from identification.output_error.search.doubts import parameter_warnings
from identification.output_error.search.estimator import estimate
from tests.support.identification.closed_form import Oscillator
from tests.support.identification.decays import decays


class Once(Oscillator):
    """Runs with the stiffness it is given first, and with no other."""

    known: float | None = None

    def simulate(self, window, values):
        self.known = self.known or values["rig.stiffness"]
        if values["rig.stiffness"] != self.known:
            raise FmuError("rig", "stiffness is not what it was")
        return super().simulate(window, values)


def test_a_parameter_whose_runs_failed_is_not_said_to_be_without_effect():
    result = estimate(decays(), Once)
    (unseen,) = result.identifiability.unseen
    assert unseen.coefficients.keys() == {"rig.stiffness"}
    assert unseen.message == (
        "rig.stiffness may have an effect or none: every run beside its estimate failed in 4 windows"
    )
    assert not any("no effect" in warning for warning in result.warnings)
    assert any("simulations failed, first: rig: stiffness" in warning for warning in result.warnings)


@pytest.mark.parametrize("value", [0.4, -0.4])
@pytest.mark.parametrize(
    ("share", "warned"), [(0.34, False), (0.99, False), (1.01, True), (3.0, True), (np.inf, False)]
)
def test_an_estimate_is_hardly_determined_when_its_standard_deviation_exceeds_its_size(value, share, warned):
    """An infinite deviation is told by what is not seen at all."""
    told = parameter_warnings(Parameter("rig.gain", 1.0), value, share * abs(value))
    assert any("rig.gain is hardly determined" in warning for warning in told) == warned
