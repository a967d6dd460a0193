"""Fits of recordings that nobody here made."""

from __future__ import annotations

from tests.support.cases.case import Case, Step


def _fit(study: str, data: str, *shows: str, code: tuple[int, ...] = (0,)) -> Case:
    return Case("fit", [Step(f"servotwin calibrate {study}.yaml --data {data} --out out/{study}", code, shows)])


CASES = {
    "fit/arm_order8_cva": _fit("arm_order8_cva", "data"),
    "fit/first_weighting_refined": _fit("first_weighting_refined", "data", "cva"),
    "fit/n4sid_at_least": _fit("n4sid_at_least", "data", code=(0, 1)),
    "fit/start_default": _fit("start_default", "data"),
    "fit/bb_integrating": _fit("bb_integrating", "bb"),
}
