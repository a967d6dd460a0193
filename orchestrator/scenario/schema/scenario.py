"""What a scenario file may say; read once and turned into a `Scenario`."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

from pydantic import ConfigDict, Field, model_validator

from fmus.errors import ScenarioError
from orchestrator.assembly.assembly import SystemSpec
from orchestrator.assembly.schema import RunBlock, SystemBlock
from orchestrator.assembly.stimulus import Stimulus
from orchestrator.assembly.whole_arrays import Values, elements, shapes
from orchestrator.fmi.interface import Value
from orchestrator.network.schema import BusBlock
from orchestrator.scenario import parameter_sets
from orchestrator.scenario.can_block import CanBlock
from orchestrator.scenario.expectations.schema import ExpectationBlock
from orchestrator.scenario.references import CaseReferences, unused
from orchestrator.scenario.scenario import Case, DataLogger, Scenario, file_stems
from orchestrator.scenario.schema.matrix import MatrixBlock
from orchestrator.scenario.schema.signals import DataLoggerBlock, StimulusBlock
from orchestrator.scenario.schema.variants import CaseBlock
from orchestrator.yaml_file import Block, load_joined, naming

LOG = logging.getLogger("servotwin.scenario")


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
        parameters: parameter sets (SSV), as a calibration writes them, and lists (CSV), over what components are
            given; later ones count, and what a case sets over all. Their names are component.variable.
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
        buses: CAN buses between FMUs with bus terminals (FMI-LS-BUS), by name.
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
    buses: dict[str, BusBlock] = {}
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

    def system(self, base: Path, said: list[str] | None = None) -> SystemSpec:
        buses = {name: block.spec(base) for name, block in self.buses.items()}
        return replace(super().system(base, said), buses=buses)

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
                self._values(number, systems[number] or shared, given.values) | elements(case.set),
                tuple(
                    expected
                    for block in (*self.expect, *case.expect)
                    for expected in common.get(id(block)) or block.expectations(base, said, accepted[number])
                ),
                shapes({**given.values, **case.set}),
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
            places=self._places(given.places),
        )

    def _places(self, given: Mapping[str, str]) -> dict[str, str]:
        """component.variable -> where its value stands in a parameter set, of those that no case sets."""
        own = {name for case in self.all_cases for name in case.set}
        return {name: place for name, place in given.items() if name not in own}

    def _systems(self, shared: SystemSpec, base: Path, said: list[str]) -> list[SystemSpec | None]:
        """The system of each case; None throughout where all have the one that they share."""
        if not any(case.has_own_system for case in self.all_cases):
            return [None for _ in self.all_cases]
        return [case.system(shared, base, said) for case in self.all_cases]

    def _values(self, number: int, system: SystemSpec, given: Values) -> dict[str, Value]:
        """component.variable -> value in the case with this number, before what the case sets.

        Args:
            given: values of parameter sets.
        """
        own = {name: value for name, value in given.items() if name.partition(".")[0] in system.components}
        values = system.values() | elements(own)
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


class ScenarioPartBlock(ScenarioBlock):
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
        fmus: component -> FMU file that takes its place, with the values in it and none of the component's; accepted
            references are then not asked for, and told.

    Raises:
        ScenarioError: no such file, or it does not fit.
        TraceError: a recording cannot be read.
    """
    file = Path(path)
    block, parts = load_joined(file, ScenarioBlock)
    with naming(file):
        scenario = block.with_fmus(fmus or {}).scenario(file, references and not fmus)
    return replace(_of_others(scenario) if fmus and references else scenario, parts=parts)


def _of_others(scenario: Scenario) -> Scenario:
    """A scenario with other FMUs than its own, of which what was accepted says nothing; that is logged."""
    kept = scenario.without_accepted()
    left = dict.fromkeys(str(asked) for case in scenario.cases for asked in case.expected if asked.accepted)
    said = [f"not asked of other FMUs than its own: {text}" for text in left]
    for line in said:
        LOG.warning("%s", line)
    return replace(kept, notes=[*kept.notes, *said])
