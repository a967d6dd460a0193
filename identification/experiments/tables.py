"""The tables of Chapters 2 and 3 of the flexible-manipulator thesis in its layout, its own figures beside ours."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

from identification.experiments.experiments import Experiments
from identification.experiments.reduction import ReductionExample, Stage
from identification.experiments.schema import ControlLoop, ExampleBlock, PrintedDeltas, SetBlock
from identification.experiments.set_result import SetResult, mean
from identification.linear.modes import modes
from identification.results import finite
from orchestrator.display.table import Cell
from orchestrator.trace import FloatArray

UNSTABLE = "unstable"
EXPERIMENTS: tuple[tuple[str, ControlLoop], ...] = (
    ("2-1", "open loop"),
    ("2-3", "bounded"),
    ("2-4", "closed loop"),
)
WORDS = {
    "initial": "as identified",
    "stabilised": "forced stable",
    "mrm": "MRM",
    "msv": "MSV",
    "mrmc": "MRMC",
    "updated": "updated",
    "further": "reduced further, updated",
}


@dataclass(frozen=True)
class ThesisTable:
    """A table by its number in the thesis."""

    KEYS = ("caption", "headers", "rows")

    number: str
    caption: str
    headers: list[str]
    rows: list[list[Cell]]


def tables(experiments: Experiments) -> list[ThesisTable]:
    """All of them, in the thesis' order."""
    identified = {number: _identification(experiments, number, kind) for number, kind in EXPERIMENTS}
    reductions = [
        table
        for name, reduction in experiments.reductions.items()
        if experiments.example(name).table
        for table in (_ranking(experiments.example(name), reduction), _stages(experiments, reduction))
    ]
    found = [
        *identified.values(),
        _frequencies(experiments),
        _special(experiments),
        _typical(experiments),
        *sorted(reductions, key=lambda table: table.number),
        _updated(experiments),
    ]
    return sorted(found, key=lambda table: table.number)


def model_name(result: SetResult, order: int | None = None) -> str:
    """As the thesis names models: O_dat2 with order 19 gives Ao2_19; a `c` stands for a compensation left in."""
    kind, _, number = result.data_set.code.partition("_dat")
    return f"A{kind.lower()}{number}_{order or result.chosen.order}{'' if result.data_set.removed else 'c'}"


def reduced_name(reduction: ReductionExample, stage: Stage) -> str:
    """As the thesis names updated models: example Ac3 with order 10 gives Ac3r_10."""
    return f"{reduction.example.name}r_{stage.model.order}"


def runs(orders: Sequence[int]) -> str:
    """Orders as the thesis writes them: 8, 11, 33-36."""
    if not orders:
        return "no stable model"
    parts: list[list[int]] = []
    for order in orders:
        if parts and parts[-1][-1] == order - 1:
            parts[-1].append(order)
        else:
            parts.append([order])
    return ", ".join(", ".join(map(str, part)) if len(part) < 3 else f"{part[0]}-{part[-1]}" for part in parts)


def _deltas(experiments: Experiments) -> list[str]:
    return [*(f"δ {name.replace('_', ' ')}" for name in experiments.study.outputs), "mean δ"]


def _errors(errors: FloatArray | None, count: int) -> list[Cell]:
    """Delta of each output and their mean."""
    if errors is None:
        return [*itertools.repeat(None, count), UNSTABLE]
    return [*(finite(float(error)) for error in errors), finite(mean(errors))]


def _printed(errors: PrintedDeltas | None, count: int) -> list[Cell]:
    return [*(errors or itertools.repeat(None, count + 1))]


def _identification(experiments: Experiments, number: str, kind: ControlLoop) -> ThesisTable:
    deltas = _deltas(experiments)
    headers = [
        "data",
        "excitation",
        "stable orders",
        "n",
        *deltas,
        "mean δ in SFV",
        "thesis: orders",
        "thesis: n",
        *(f"thesis: {delta}" for delta in deltas),
    ]
    rows = [
        _row(block, experiments.results[code], len(experiments.study.outputs))
        for code, block in experiments.study.sets.items()
        if block.experiment == kind
    ]
    return ThesisTable(number, f"Identification results of the {kind} experiments (errors: DMV)", headers, rows)


def _row(block: SetBlock, result: SetResult, count: int) -> list[Cell]:
    chosen, printed = result.chosen, block.published
    load = f", {1000 * block.payload:g} g" if block.payload else ""
    what = f"{block.excitation} {block.volts:g} V, {block.rate:g} Hz{load}"
    sfv: Cell = UNSTABLE if chosen.errors.sfv is None else mean(chosen.errors.sfv)
    return [
        result.data_set.code,
        what,
        runs(result.stable),
        chosen.order,
        *_errors(chosen.errors.dmv, count),
        sfv,
        printed.orders if printed else None,
        printed.order if printed else None,
        *_printed(printed.delta if printed else None, count),
    ]


def _frequencies(experiments: Experiments) -> ThesisTable:
    """Table 2-2: a column a data set, ours and the thesis'."""
    study = experiments.study
    columns: list[tuple[str, list[float]]] = []
    for code, printed in study.frequencies.items():
        attempt = experiments.results[code].attempt(study.compared)
        found = [] if attempt is None else [mode.frequency for mode in modes(attempt.model) if mode.paired]
        columns += [(f"{study.sets[code].excitation} [Hz]", found), ("thesis [Hz]", printed)]
    rows: list[list[Cell]] = [list(row) for row in itertools.zip_longest(*(column for _, column in columns))]
    return ThesisTable(
        "2-2", f"Natural frequencies of models of order {study.compared}", [name for name, _ in columns], rows
    )


def _special(experiments: Experiments) -> ThesisTable:
    """Table 2-5: examples that are not of type I or II, or not stable."""
    rows: list[list[Cell]] = []
    for name, reduction in experiments.reductions.items():
        example, order = experiments.example(name), reduction.stages[0].model.order
        if example.unstable or not example.removed:
            stability = "unstable" if any(stage.name == "stabilised" for stage in reduction.stages) else "stable"
            printed = example.published.model if example.published else None
            rows.append([_original(experiments, reduction), _data(example), order, stability, printed])
    return ThesisTable("2-5", "Special models", ["model", "data", "order", "stability", "thesis: model"], rows)


def _data(example: ExampleBlock) -> str:
    return example.data if example.removed else f"{example.data}, compensation left in"


def _typical(experiments: Experiments) -> ThesisTable:
    study = experiments.study
    rows: list[list[Cell]] = []
    for code in study.typical:
        result, block = experiments.results[code], study.sets[code]
        rows.append(
            [
                model_name(result),
                f"first {block.samples // 2} samples of {code}",
                result.chosen.order,
                "stable" if result.stable else "unstable",
                block.experiment,
                block.published.order if block.published else None,
            ]
        )
    return ThesisTable(
        "2-6", "Typical identified models", ["model", "data", "order", "stability", "experiment", "thesis: order"], rows
    )


def _ranking(example: ExampleBlock, reduction: ReductionExample) -> ThesisTable:
    """Table 3-Na."""
    ranking, printed = reduction.ranking, example.published
    ours: list[list[Cell]] = [
        [
            label,
            finite(mode.frequency) if mode.paired else "real",
            finite(mode.damping) if mode.paired else None,
            mrm,
            msv,
        ]
        for label, mode, mrm, msv in zip(ranking.labels, ranking.modes, ranking.mrm, ranking.msv, strict=True)
    ]
    theirs: list[list[Cell]] = [
        ["real" if frequency is None else frequency, damping, mrm, msv]
        for frequency, damping, mrm, msv in (printed.modes if printed else [])
    ]
    rows = [[*(a or [None] * 5), *(b or [None] * 4)] for a, b in itertools.zip_longest(ours, theirs)]
    headers = [
        "mode",
        "frequency [Hz]",
        "damping",
        "MRM rank",
        "MSV rank",
        "thesis: frequency [Hz]",
        "thesis: damping",
        "thesis: MRM rank",
        "thesis: MSV rank",
    ]
    name = f" (thesis: {printed.model})" if printed else ""
    return ThesisTable(f"{example.table}a", f"Modes of the model of {_data(example)}{name}", headers, rows)


def _stages(experiments: Experiments, reduction: ReductionExample) -> ThesisTable:
    """Table 3-Nb."""
    example = experiments.example(reduction.example.name)
    rows = [row for stage in reduction.stages for row in _validated(experiments, reduction, stage)]
    deltas = _deltas(experiments)
    headers = ["modes kept", "stage", "order", "validation", *deltas, *(f"thesis: {delta}" for delta in deltas)]
    caption = f"Reduction and updating of the model of {_data(example)}"
    return ThesisTable(f"{example.table}b", caption, headers, rows)


def _validated(experiments: Experiments, reduction: ReductionExample, stage: Stage) -> list[list[Cell]]:
    count, example = len(experiments.study.outputs), experiments.example(reduction.example.name)
    printed = example.published.stages.get(stage.name) if example.published else None
    word = WORDS[stage.name] + (f" from {example.by.upper()}" * (stage.name == "updated"))
    head: list[Cell] = [", ".join(stage.kept) or "all", word, stage.model.order]
    return [
        [*head, "DMV", *_errors(stage.errors.dmv, count), *_printed(printed.dmv if printed else None, count)],
        [*head, "SFV", *_errors(stage.errors.sfv, count), *_printed(printed.sfv if printed else None, count)],
    ]


def _updated(experiments: Experiments) -> ThesisTable:
    """Table 3-6."""
    rows: list[list[Cell]] = []
    for name, reduction in experiments.reductions.items():
        for stage in reduction.final if experiments.example(name).listed else []:
            head: list[Cell] = [reduced_name(reduction, stage), _original(experiments, reduction)]
            for _, _, order, *rest in _validated(experiments, reduction, stage):
                rows.append([*head, f"{order}, {reduction.example.by.upper()}", *rest])
    deltas = _deltas(experiments)
    headers = ["model", "original", "order, method", "validation", *deltas, *(f"thesis: {delta}" for delta in deltas)]
    return ThesisTable("3-6", "Updated reduced models", headers, rows)


def _original(experiments: Experiments, reduction: ReductionExample) -> str:
    example = experiments.example(reduction.example.name)
    result = experiments.results[example.data if example.removed else f"{example.data}c"]
    return model_name(result, reduction.stages[0].model.order) + ("u" if example.unstable else "")
