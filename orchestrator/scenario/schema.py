"""What a scenario file may say; read once and turned into a `Scenario`."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, model_validator

from fmus.errors import ScenarioError
from orchestrator.assembly.assembly import SystemSpec, link
from orchestrator.assembly.schema import Components, Connections, RunBlock, SignalFileBlock, SystemBlock
from orchestrator.assembly.stimulus import Stimulus
from orchestrator.assembly.whole_arrays import Values, elements, shapes
from orchestrator.formats.schema import LayoutBlock
from orchestrator.scenario import matrix, parameter_sets
from orchestrator.scenario.can_block import CanBlock
from orchestrator.scenario.expectations.schema import ExpectationBlock
from orchestrator.scenario.references import CaseReferences, unused
from orchestrator.scenario.scenario import Case, DataLogger, Scenario, file_stems
from orchestrator.system import nearest
from orchestrator.yaml_file import Block, Quantity, load_joined, may_be_partial, naming

LOG = logging.getLogger("servotwin.scenario")


class StimulusBlock(Block):
    """What drives an input: a constant, or a signal of a trace file.

    Attributes:
        constant: in the unit of the input, or with its own: `90 deg`.
        file: a recording, relative to this file; instead of `constant`.
        signal: its name in the recording.
        factor, offset: input = factor * signal + offset, over what their units say.
        interpolation: between samples; by default `hold` where the input is no real number or discrete, else `linear`.
        ends: what holds before the file begins and after it ends: nothing, or its first and its last value.
        layout: how the file is laid out, where it does not tell.
    """

    constant: float | Quantity | None = None
    file: Path | None = None
    signal: str | None = None
    factor: float | None = None
    offset: float | None = None
    interpolation: Literal["linear", "hold"] | None = None
    ends: Literal["refuse", "hold"] = "refuse"
    layout: LayoutBlock = LayoutBlock()

    @model_validator(mode="after")
    def _one_kind(self) -> StimulusBlock:
        if (self.constant is None) == (self.file is None) or (self.file is None) != (self.signal is None):
            raise ValueError("give `constant`, or `file` and `signal`")
        if self.constant is not None and self.ends == "hold":
            raise ValueError("`ends` goes with `file`; a constant has none")
        if self.constant is not None and (self.factor is not None or self.offset is not None):
            raise ValueError("`factor` and `offset` go with `file`; write `constant: 90 deg`")
        return self

    def stimulus(self, base: Path, said: list[str] | None = None) -> Stimulus:
        """The stimulus; its file is relative to `base`, and what is to be known of it is added to `said`."""
        if self.constant is not None:
            return Stimulus(self.constant)
        assert self.file is not None and self.signal is not None
        recording = SignalFileBlock(
            file=self.file, signal=self.signal, factor=self.factor, offset=self.offset, layout=self.layout
        )
        hold = None if self.interpolation is None else self.interpolation == "hold"
        return Stimulus(
            recording.trace(base, said),
            hold,
            recording.given,
            self.ends == "hold",
            base / self.file,
        )


class DataLoggerBlock(Block):
    """A data logger that samples the run; see `DataLogger`."""

    explained_by = (DataLogger,)

    model_config = ConfigDict(json_schema_extra=may_be_partial)

    signals: dict[str, str] = Field(min_length=1)
    every: float = Field(gt=0)
    jitter: float = Field(DataLogger.jitter, ge=0, lt=1)
    first: float | None = Field(DataLogger.first, ge=0)
    seed: int = DataLogger.seed


class VariantBlock(Block):
    """What differs from the scenario: values, what must hold besides, components and connections that are added.

    Attributes:
        set: component.variable -> value, over those of the scenario, in the unit of the variable or its own: `400 g`.
        expect: what must hold besides what the scenario expects.
        use: names of `sets` whose values it takes; later ones count, and `set` over all.
        components: as those of a scenario, over those of the same name there; a case with any is run with a system of
            its own.
        connections: besides those of the scenario.
    """

    use: list[str] = []
    set: Values = {}
    expect: list[ExpectationBlock] = []
    components: Components = {}
    connections: Connections = []

    @property
    def has_own_system(self) -> bool:
        """Whether it is run with a system of its own."""
        return bool(self.components or self.connections)

    def system(self, common: SystemSpec, base: Path, said: list[str]) -> SystemSpec:
        """Its system: the common one with what it adds; files are relative to `base`."""
        own = {name: block.spec(base, said) for name, block in self.components.items()}
        return SystemSpec({**common.components, **own}, (*common.connections, *map(link, self.connections)))

    def values(self, sets: Mapping[str, Values]) -> dict[str, Any]:
        """component.variable -> value, of the sets that it uses and its own.

        Raises:
            ValueError: there is no such set.
        """
        if unknown := next((name for name in self.use if name not in sets), None):
            raise ValueError(f"there is no set '{unknown}'; {nearest(unknown, sets)}")
        given: dict[str, Any] = {}
        for name in self.use:
            given |= sets[name]
        return given | self.set


class CaseBlock(VariantBlock):
    """A variant of the scenario with a name.

    Attributes:
        name: of the case, in tables and, as far as letters allow, of the file with its trace.
    """

    name: str


Level = int | float | bool | str
Levels = Annotated[list[Level], Field(min_length=1)] | Annotated[dict[str, VariantBlock], Field(min_length=1)]


class SelectionBlock(VariantBlock):
    """Something for some cases of a matrix only.

    Attributes:
        where: axis -> level or levels; of axes that are not named all are meant.
    """

    where: dict[str, Level | list[Level]] = Field(min_length=1)


class MatrixBlock(Block):
    """Cases that are all combinations of the levels of some axes.

    Attributes:
        axes: name -> levels by name, each a variant; or component.variable -> list of its values.
        name: of a case, with every `{axis}` in it, by default the levels with commas between them.
        exclude: combinations that are left out, each as axis -> level or levels.
        also: what goes for some combinations besides.
    """

    axes: dict[str, Levels] = Field(min_length=1)
    name: str | None = None
    exclude: list[dict[str, Level | list[Level]]] = []
    also: list[SelectionBlock] = []

    @model_validator(mode="after")
    def _names_what_is_there(self) -> MatrixBlock:
        axes = self._levels()
        for one in (*self.exclude, *(block.where for block in self.also)):
            matrix.check_selection(_selection(one), axes)
        if self.name is not None:
            matrix.check_template(self.name, axes)
        self._combinations()
        return self

    def cases(self, sets: Mapping[str, Values]) -> list[CaseBlock]:
        """All cases, the last axis changes fastest.

        Raises:
            ValueError: there is no such set, two axes set one variable, or what is for some cases fits none.
        """
        combined = self._combinations()
        for block in self.also:
            if not any(matrix.selects(_selection(block.where), one) for one in combined):
                raise ValueError(f"no case of the matrix fits {block.where}; correct `where`")
        return [self._case(one, sets) for one in combined]

    def _combinations(self) -> list[matrix.Combination]:
        return matrix.combinations(self._levels(), [_selection(one) for one in self.exclude])

    def _levels(self) -> dict[str, list[str]]:
        """axis -> names of its levels."""
        return {axis: [str(level) for level in levels] for axis, levels in self.axes.items()}

    def _case(self, one: matrix.Combination, sets: Mapping[str, Values]) -> CaseBlock:
        values: dict[str, Any] = {}
        parts = [self._variant(axis, level) for axis, level in one.items()]
        for part in parts:
            given = part.values(sets)
            if twice := sorted(values.keys() & given):
                raise ValueError(f"two axes of the matrix set {twice[0]}; leave it out of one")
            values |= given
        also = [block for block in self.also if matrix.selects(_selection(block.where), one)]
        for block in also:
            values |= block.values(sets)
        parts += also
        return CaseBlock(
            name=matrix.named(self.name, one),
            set=values,
            expect=[block for part in parts for block in part.expect],
            components={name: block for part in parts for name, block in part.components.items()},
            connections=[line for part in parts for line in part.connections],
        )

    def _variant(self, axis: str, level: str) -> VariantBlock:
        levels = self.axes[axis]
        if isinstance(levels, dict):
            return levels[level]
        return VariantBlock(set={axis: next(value for value in levels if str(value) == level)})


def _selection(where: Mapping[str, Level | list[Level]]) -> dict[str, list[str]]:
    return {axis: [str(one) for one in (some if isinstance(some, list) else [some])] for axis, some in where.items()}


def _parts_may_have_the_rest(schema: dict[str, Any]) -> None:
    """For editors: with `include` a scenario itself needs nothing but its title."""
    blocks: dict[str, type[Block]] = {"run": RunBlock, "recorder": DataLoggerBlock}
    needed = {key: [n for n, one in block.model_fields.items() if one.is_required()] for key, block in blocks.items()}
    schema["if"] = {"not": {"required": ["include"]}}
    schema["then"] = {
        "required": schema["required"],
        "properties": {key: {"required": names} for key, names in needed.items()},
    }
    schema["required"] = ["title"]


def _needs_nothing_but_its_name(schema: dict[str, Any]) -> None:
    schema["required"] = ["part"]


class ScenarioBlock(SystemBlock):
    """A scenario file.

    Attributes:
        title: what it is, in a line.
        description: more of it, and why its expectations are what they are.
        stimuli: component.input -> what drives it.
        parameters: parameter sets (SSV), as a calibration writes them, over what components are given; later ones
            count, and what a case sets over all. Their names are component.variable.
        run: when it begins and ends, and how it steps.
        record: component.variable that the trace holds, by default all outputs.
        recorder: samples the run as hardware does; its samples are written instead of the trace.
        cases: variants, each with a name; by default the scenario as it is.
        expect: what must hold in every case.
        sets: name -> component.variable -> value, for cases that `use` them.
        matrix: cases that are all combinations of some axes; those of `cases` come after them.
        own_noise: whether every case draws noise of its own: each `seed` that a component is given, and the case does
            not set, grows by 1000 from case to case.
        ssp: the description (`.ssd`) that it was imported from, whose annotations go along when it is exported.
        can: how it is coupled to a CAN bus; a plain run takes the safe values, as if nobody else were there.
    """

    model_config = ConfigDict(json_schema_extra=_parts_may_have_the_rest)

    title: str
    description: str = ""
    stimuli: dict[str, StimulusBlock] = {}
    parameters: Path | list[Path] | None = None
    run: RunBlock
    record: list[str] | None = None
    recorder: DataLoggerBlock | None = None
    own_noise: bool = False
    ssp: Path | None = None
    can: CanBlock | None = None
    sets: dict[str, Values] = {}
    matrix: MatrixBlock | None = None
    cases: Annotated[list[CaseBlock], Field(min_length=1)] | None = None
    expect: list[ExpectationBlock] = []

    @model_validator(mode="after")
    def _distinct_cases(self) -> ScenarioBlock:
        names = [case.name for case in self.all_cases]
        if twice := next((name for name, count in Counter(names).items() if count > 1), None):
            raise ValueError(f"two cases have one name, {twice}")
        return self

    @cached_property
    def all_cases(self) -> list[CaseBlock]:
        """Those of the matrix, and those that are written out, with the values of the sets that they use."""
        if self.matrix is None and self.cases is None:
            return [CaseBlock(name="run")]
        written = [case.model_copy(update={"set": case.values(self.sets), "use": []}) for case in self.cases or ()]
        return [*(self.matrix.cases(self.sets) if self.matrix else ()), *written]

    @model_validator(mode="after")
    def _one_system_on_a_bus(self) -> ScenarioBlock:
        own = next((case.name for case in self.all_cases if case.has_own_system), None)
        if own is not None and self.can is not None:
            raise ValueError(f"case {own} has components of its own, which a scenario with `can` cannot have")
        return self

    @model_validator(mode="after")
    def _one_source_each(self) -> ScenarioBlock:
        twice = sorted(set(self.stimuli) & set(self.can.receive if self.can else ()))
        if twice:
            raise ValueError(f"{twice[0]} has two sources, a stimulus and a signal of the bus")
        return self

    def with_fmus(self, fmus: Mapping[str, Path]) -> ScenarioBlock:
        """The same with these FMU files in place of components.

        Raises:
            ScenarioError: there is no such component or file.
        """
        for name, file in fmus.items():
            if name not in self.components:
                known = ", ".join(self.components)
                raise ScenarioError(f"--fmu {name}", "no such component", f"there are {known}")
            if not file.is_file():
                raise ScenarioError(f"--fmu {name}", f"no file {file}", "give an FMU that is there")
        for case in self.all_cases:
            if own := sorted(case.components.keys() & fmus):
                raise ScenarioError(f"--fmu {own[0]}", f"is another component in case {case.name}", "write it there")
        replaced = {name: self.components[name].replaced(file) for name, file in fmus.items()}
        return self.model_copy(update={"components": {**self.components, **replaced}})

    def scenario(self, path: Path, references: bool = True) -> Scenario:
        """The scenario of the file at `path`, to which the paths in it are relative, with all that it reads.

        Args:
            references: whether accepted references are read.

        Raises:
            TraceError: a stimulus, a table or a reference cannot be read.
        """
        base, said = path.parent, list[str]()
        safe = {name: Stimulus(block.safe) for name, block in (self.can.receive if self.can else {}).items()}
        common = {id(block): block.expectations(base, said) for block in self.expect if not block.of_a_case}
        names = [case.name for case in self.all_cases]
        accepted = [
            CaseReferences(path, name, stem, references) for name, stem in zip(names, file_stems(names), strict=True)
        ]
        shared = self.system(base, said)
        sets = parameter_sets.joined(self.parameters, base)
        components = [*shared.components, *(name for case in self.all_cases for name in case.components)]
        given = parameter_sets.values_of(sets, components)
        systems = self._systems(shared, base, said)
        cases = tuple(
            Case(
                case.name,
                self._values(number, systems[number] or shared, given) | elements(case.set),
                tuple(
                    expected
                    for block in (*self.expect, *case.expect)
                    for expected in common.get(id(block)) or block.expectations(base, said, accepted[number])
                ),
                shapes({**given, **case.set}),
                systems[number],
            )
            for number, case in enumerate(self.all_cases)
        )
        if references:
            said += _tell_unused(path, [file for one in accepted for file in one.asked])
        return Scenario(
            path,
            self.title,
            self.description,
            systems[0] or shared,
            self.run.timing(),
            {name: block.stimulus(base, said) for name, block in self.stimuli.items()} | safe,
            None if self.record is None else tuple(self.record),
            DataLogger(**dict(self.recorder)) if self.recorder else None,
            cases,
            self.can,
            said,
            parameter_sets=tuple(sets),
        )

    def _systems(self, shared: SystemSpec, base: Path, said: list[str]) -> list[SystemSpec | None]:
        """The system of each case; None throughout where all have the one that they share."""
        if not any(case.has_own_system for case in self.all_cases):
            return [None for _ in self.all_cases]
        return [case.system(shared, base, said) for case in self.all_cases]

    def _values(self, number: int, system: SystemSpec, given: Mapping[str, Any]) -> dict[str, Any]:
        """component.variable -> value in the case with this number, before what the case sets.

        Args:
            given: values of parameter sets.
        """
        own = {name: value for name, value in given.items() if name.partition(".")[0] in system.components}
        values: dict[str, Any] = system.values() | elements(own)
        if not self.own_noise:
            return values
        seeds = {name: seed for name, seed in values.items() if name.endswith(".seed") and isinstance(seed, int)}
        return values | {name: seed + 1000 * number for name, seed in seeds.items()}


def _tell_unused(scenario: Path, asked: Sequence[Path]) -> list[str]:
    """A line about each accepted reference that is there and not asked for, which is logged, too."""
    lines = [f"{file}: no case asks for this reference" for file in unused(scenario, asked)]
    for line in lines:
        LOG.warning("%s", line)
    return lines


class PartBlock(ScenarioBlock):
    """What editors check a part of scenarios by: it may have any key of one.

    Attributes:
        part: what it is, in words.
    """

    model_config = ConfigDict(json_schema_extra=_needs_nothing_but_its_name)

    part: str


def load_scenario(path: str | Path, references: bool = True, fmus: Mapping[str, Path] | None = None) -> Scenario:
    """The scenario in a file, with the recordings that it names.

    Args:
        references: whether its accepted references are read; what is to be replaced need not be fit for it.
        fmus: component -> FMU file that takes its place, with the values in it and none of the component's.

    Raises:
        ScenarioError: no such file, or it does not fit.
        TraceError: a recording cannot be read.
    """
    file = Path(path)
    block, parts = load_joined(file, ScenarioBlock)
    with naming(file):
        return replace(block.with_fmus(fmus or {}).scenario(file, references), parts=parts)
