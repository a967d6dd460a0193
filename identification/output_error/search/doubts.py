"""What a reader of an estimate has to know beside the numbers, one sentence each."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from identification.estimation.identifiability import Combination
from identification.estimation.parameters import Parameter
from identification.estimation.uncertainty import Covariance
from identification.output_error.search.estimate import VAGUE, Estimate
from identification.output_error.search.problem import Problem

_LITTLE = 0.1  # of a prior's variance, taken away: less is little
_CONTRADICTED = 3.0  # standard deviations of a prior
_BEYOND = 2.0  # standard deviations beyond a bound, which noise alone hardly makes where the truth is within
_OFF = 0.5  # standard deviations of another parameter, from which its interval suffers
_SHARED = 0.01  # of the samples, in more than one window: less is a rounded end


def doubts(problem: Problem, result: Estimate) -> list[str]:
    """One sentence for everything that makes the numbers worth less than they look."""
    seen = result.identifiability
    named = [combo for combo in (*seen.unseen, *seen.weak) if not set(combo.coefficients) <= set(result.flat)]
    warnings = [_only_known(combo, result) for combo in named]
    warnings += [f"what would show {' and '.join(combo.coefficients)}: {combo.remedy}" for combo in named]
    warnings += [*result.intervals.remarks, *_of_priors(result)]
    for name, (low, high) in result.flat.items():
        unit = next(p.unit for p in problem.parameters.free if p.name == name)
        range_ = f"from {low:.6g} to {high:.6g} {unit}"
        warnings.append(f"{name} acts in steps: the outputs do not tell {range_} apart, which its interval holds")
    for parameter in problem.parameters.free:
        warnings += parameter_warnings(parameter, result.values[parameter.name], result.std[parameter.name])
    warnings += _beyond_bounds(problem.parameters.free, result)
    told = " ".join(warnings)
    for parameter in problem.parameters.free:
        lost = math.isinf(result.std[parameter.name]) and result.uncertainty.method != "none"
        if lost and parameter.name not in told:
            factor = f"a factor of {math.exp(VAGUE):g} either way"
            warnings.append(f"{parameter.name} is not determined: its 95 % interval would reach over {factor}")
    warnings += _overlap(problem, result)
    warnings += _misfit(problem.outputs, len(problem.windows), result.uncertainty)
    warnings += _coarse(result)
    if result.tally.failures:
        failures, total = result.tally.failures, result.tally.simulations
        warnings.append(f"{failures} of {total} simulations failed, first: {result.tally.reasons[0]}")
    return warnings


def _misfit(outputs: Sequence[str], windows: int, uncertainty: Covariance) -> list[str]:
    """That residuals are not white, what that means for the intervals, and of what they speak."""
    if uncertainty.is_white or uncertainty.method == "none":
        return []
    tests = zip(outputs, uncertainty.whiteness, strict=True)
    found = ", ".join(f"{name} ({test.why_not})" for name, test in tests if not test.white)
    if uncertainty.method == "coloured":
        how = (
            f"residuals are correlated and {windows} windows are too few to judge them by windows: "
            "intervals rest on a fitted noise model and miss model errors, cut the traces into more windows"
        )
    else:
        how = f"intervals rest on how {windows} windows scatter (sandwich){_wider(uncertainty)}"
    return [
        f"residuals are not white, of {found}: the noise is coloured, or the model leaves something out or has a "
        "constant wrong; intervals tell how exactly the best fit of this model is known, not how near it is to the "
        "truth, which may lie many half-widths outside",
        how,
    ]


def _overlap(problem: Problem, result: Estimate) -> list[str]:
    """That windows share samples, and what intervals make of it."""
    if problem.counted <= 1 + _SHARED or result.uncertainty.method == "none":
        return []
    so = (
        "a bootstrap draws them as independent ones, so that its intervals are too narrow: let `every` be `length`"
        if result.intervals.by == "bootstrap"
        else f"intervals are {math.sqrt(problem.counted):.2g} times as wide as if these were independent"
    )
    return [f"windows overlap, a sample is in {problem.counted:.2g} of them on average: {so}"]


def _beyond_bounds(free: Sequence[Parameter], result: Estimate) -> list[str]:
    """Parameters whose bounds hold them where the recordings contradict that, and what this does to the others."""
    std = np.sqrt(np.diag(result.uncertainty.matrix))
    steps = np.divide(result.uncertainty.step, std, out=np.zeros(len(std)), where=np.isfinite(std) & (std > 0))
    held = [one.at_bound(result.values[one.name]) for one in free]
    apart = [column for column, bound in enumerate(held) if bound is not None and abs(steps[column]) > _BEYOND]
    moved = {one.name: abs(float(steps[column])) for column, one in enumerate(free) if held[column] is None}
    other = max(moved, key=moved.__getitem__, default=None)
    if not apart or other is None or moved[other] < _OFF:
        return []
    beyond = " and ".join(f"{free[column].name} by {abs(steps[column]):.2g}" for column in apart)
    return [
        f"slopes lead beyond bounds, in standard deviations: {beyond}; if these bounds are wrong, {other} is off by "
        f"{moved[other]:.2g} of its own, and intervals do not hold that"
    ]


def _only_known(combination: Combination, result: Estimate) -> str:
    """What a combination is not seen by, and that priors tell its parameters where they do."""
    told = all(math.isfinite(result.std[name]) for name in combination.coefficients)
    return (
        f"{combination.message}; what is told beyond that is by priors"
        if told and result.known
        else combination.message
    )


def _of_priors(result: Estimate) -> list[str]:
    """Where the recordings add little to what was known before, or contradict it."""
    little = [
        f"{name} is what was known before ({known.text}): the recordings add {100 * known.added:.0f} %"
        for name, known in result.known.items()
        if known.added < _LITTLE
    ]
    return little + [
        f"{name} is {abs(known.off):.1f} standard deviations from what was known before ({known.text}): the prior, the "
        "model or another constant is wrong"
        for name, known in result.known.items()
        if abs(known.off) > _CONTRADICTED
    ]


def _wider(uncertainty: Covariance) -> str:
    """How much wider intervals are than those for white noise."""
    own, white = (np.diag(uncertainty.matrices[method]) for method in (uncertainty.method, "white"))
    known = np.isfinite(own) & (white > 0)
    if not known.any():
        return ""
    ratios = np.sqrt(own[known] / white[known])
    low, high = float(ratios.min()), float(ratios.max())
    return f", {low:.2g} to {high:.2g} times as wide as for white noise"


def _coarse(result: Estimate) -> list[str]:
    """That residuals are smaller than the rounding of what was recorded."""
    return [
        f"{noise.output} is recorded in steps of {noise.resolution:.3g}, and its residuals ({noise.std:.2g} rms) are "
        f"smaller than that rounds ({noise.rounding:.2g}): intervals count the rounding as noise"
        for noise in result.noise
        if noise.std < noise.rounding
    ]


def parameter_warnings(parameter: Parameter, value: float, std: float) -> list[str]:
    """What makes an estimate worth less than it looks: it lies at a bound, or its sign is not determined."""
    warnings = []
    if (bound := parameter.at_bound(value)) is not None:
        word = "lower" if bound == parameter.lower else "upper"
        at = f"{parameter.name} is at its {word} bound {bound:g} {parameter.unit}"
        warnings.append(f"{at}: the best value may lie beyond, and its interval is as without that bound; widen it")
    if math.isfinite(std) and std > abs(value):
        warnings.append(f"{parameter.name} is hardly determined: {value:.3g} with a standard deviation of {std:.3g}")
    return warnings
