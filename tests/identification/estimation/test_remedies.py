"""What would tell parameters apart, by their units."""

from __future__ import annotations

import pytest

from identification.estimation.parameters import Parameter
from identification.estimation.remedies import kind_of, separating


@pytest.mark.parametrize(
    ("unit", "kind"),
    [
        ("kg", "inertia"),
        ("kg.m2", "inertia"),
        ("N.m.s/rad", "damping"),
        ("N.s/m", "damping"),
        ("N.m/rad", "stiffness"),
        ("N/m", "stiffness"),
        ("N", "force"),
        ("N.m", "force"),
        ("N.m/V", "gain"),
        ("N.m/A", "gain"),
        ("V.s/rad", "gain"),
        ("ms", "time"),
        ("Hz", "other"),
        ("rad", "other"),
        ("1", "other"),
        ("no unit at all", "other"),
    ],
)
def test_a_unit_says_what_a_parameter_is_of(unit: str, kind: str) -> None:
    assert kind_of(unit) == kind


@pytest.mark.parametrize(
    ("units", "only_ratios", "remedy"),
    [
        (("kg.m2", "N.m.s/rad", "N.m/V"), True, "an added mass, or a sensor of the force or the current"),
        (("kg.m2", "N.m/rad"), True, "an added mass, or a sensor"),
        (("kg.m2", "N.m/rad"), False, "an added mass"),
        (("N.m.s/rad", "V.s/rad"), False, "a current sensor"),
        (("N.m.s/rad", "N.m"), False, "a slower sweep"),
        (("N.m", "N.m"), False, "both sides"),
        (("kg.m2", "s"), False, "sampled faster"),
        (("1", "rad"), True, "`prior`"),
    ],
)
def test_what_would_tell_them_apart(units: tuple[str, ...], only_ratios: bool, remedy: str) -> None:
    named = [Parameter(f"a.p{i}", 1.0, unit=unit) for i, unit in enumerate(units)]
    assert remedy in separating(named, only_ratios)
