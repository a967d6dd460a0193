"""Curves are told apart by people who see few colours, and stand out from the paper, by day and by night."""

from __future__ import annotations

import re
from importlib import resources
from itertools import combinations

import numpy as np
import pytest

from orchestrator.report.chart import COLOURS, Curve, key_of
from orchestrator.trace import FloatArray

SHEET = (resources.files("orchestrator.report") / "style.css").read_text(encoding="utf-8")
LIGHT, DARK, OF_PAPER = re.findall(r":root(?::not\(\.paper\)|\.paper)? \{(.*?)\}", SHEET, re.DOTALL)
PAPER = OF_PAPER + LIGHT  # what it does not say of a colour, the light theme does

# What is left of linear RGB for eyes without one kind of cone (Machado, Oliveira and Fernandes 2009, severity 1).
EYES = {
    "all": np.eye(3),
    "no red": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "no green": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]]
    ),
    "no blue": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.3039]]
    ),
}
TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def linear(theme: str, name: str) -> FloatArray:
    """(3,) linear RGB of a colour of a theme."""
    found = re.search(rf"--{name}: #(\w\w)(\w\w)(\w\w);", theme)
    assert found is not None
    shares = np.array([int(part, 16) for part in found.groups()]) / 255
    return np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)


def lab(rgb: FloatArray) -> FloatArray:
    """(3,) CIELAB of linear RGB, where distances are as they are seen; 2.3 is just seen."""
    xyz = TO_XYZ @ np.clip(rgb, 0, 1) / np.array([0.9505, 1.0, 1.089])
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def contrast(one: FloatArray, other: FloatArray) -> float:
    """Of two colours, as WCAG 2 defines it."""
    darker, lighter = sorted(float(TO_XYZ[1] @ rgb) for rgb in (one, other))
    return (lighter + 0.05) / (darker + 0.05)


@pytest.mark.parametrize("theme", [LIGHT, DARK, PAPER], ids=["light", "dark", "paper"])
@pytest.mark.parametrize("eyes", EYES)
def test_no_two_curves_look_alike_to_any_eyes(theme: str, eyes: str) -> None:
    seen = [lab(EYES[eyes] @ linear(theme, f"c{number}")) for number in range(COLOURS)]
    assert min(float(np.linalg.norm(one - other)) for one, other in combinations(seen, 2)) > 18


@pytest.mark.parametrize("theme", [LIGHT, DARK, PAPER], ids=["light", "dark", "paper"])
def test_curves_and_words_stand_out_from_the_paper(theme: str) -> None:
    paper = linear(theme, "paper")
    for number in range(COLOURS):
        assert contrast(linear(theme, f"c{number}"), paper) >= 3  # WCAG 2.1, 1.4.11
    for words in ("ink", "soft", "accent", "ok", "warning", "error"):
        assert contrast(linear(theme, words), paper) >= 4.5  # 1.4.3


def test_curves_of_different_colours_also_have_different_dashes() -> None:
    script = (resources.files("orchestrator.report") / "chart.js").read_text(encoding="utf-8")
    found = re.search(r"const DASHES = \[(.*)\];", script)
    assert found is not None
    dashes = re.findall(r"\[[^\[\]]*\]", found[1])
    assert len(set(dashes)) == len(dashes) == COLOURS


def test_curves_of_the_same_colour_have_different_dashes_in_charts_and_legends() -> None:
    script = (resources.files("orchestrator.report") / "chart.js").read_text(encoding="utf-8")
    assert "DASHES[(colour + Math.floor(colour / 6)) % 6]" in script
    keys = [key_of(Curve("one", [0.0], [0.0], colour=number)) for number in range(3 * COLOURS)]
    assert len(set(keys)) == len(keys)
    assert re.findall(r"(k\d) (d\d)", keys[0] + keys[COLOURS]) == [("k0", "d0"), ("k0", "d1")]
