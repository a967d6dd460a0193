"""Fits of recordings that nobody here made."""

from __future__ import annotations

import shutil
from pathlib import Path

from tests.support.cases.case import Case, Step
from tests.support.tools import third_party


def _fit(study: str, data: str, *shows: str, code: tuple[int, ...] = (0,)) -> Case:
    return Case("fit", [Step(f"servotwin calibrate {study}.yaml --data {data} --out out/{study}", code, shows)])


def _clutches(folder: Path) -> None:
    """Fetch the FMUs of others that the studies name."""
    fmus = folder / "fmu"
    fmus.mkdir(exist_ok=True)
    shutil.copyfile(third_party.coupled_clutches(), fmus / "clutches.fmu")
    shutil.copyfile(third_party.reference(3, "VanDerPol"), fmus / "vdp3.fmu")


def _in_steps(name: str, study: str, *shows: str) -> Case:
    """Parameters that act in steps: found, and the steps are told."""
    run = Step(f"servotwin calibrate {study}.yaml --data . --out out", 0, (*shows, r"acts in steps"))
    return Case(f"fit/{name}", [run], _clutches)


CASES = {
    "fit/arm_order8_cva": _fit("arm_order8_cva", "data"),
    "fit/first_weighting_refined": _fit("first_weighting_refined", "data", "cva"),
    "fit/n4sid_at_least": _fit("n4sid_at_least", "data", code=(0, 1)),
    "fit/start_default": _fit("start_default", "data"),
    "fit/bb_integrating": _fit("bb_integrating", "bb"),
    "fit/clutch": _in_steps("clutch", "clutch", r"c\.T2 +0\.55 +0\.4 +0\.55", r"c\.freqHz +0\.27 +0\.2 +0\.2[67]"),
    "fit/pair": _in_steps("pair", "pair_o", r"v\.mu +2\.3 +1 +2\.[23]", r"c\.T2 +0\.55 +0\.4 +0\.5[45]"),
}
