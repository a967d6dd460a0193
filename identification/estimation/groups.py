"""Parameters with a value of their own in each group of recordings: a payload, friction at another temperature.

Each value is a parameter, `component.variable@group`; a window is given that of its recording's group.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath

from fmus.errors import ScenarioError
from identification.estimation.parameters import Around, Parameter, ParameterSet, Tie

MARK = "@"


@dataclass(frozen=True)
class Grouping:
    """How a parameter is to be told apart.

    Attributes:
        groups: name -> recordings; None where each recording is a group.
        around: standard deviation of the values about their mean, where that is known [the parameter's unit].
    """

    groups: Mapping[str, tuple[str, ...]] | None = None
    around: float | None = None


@dataclass(frozen=True)
class Grouped:
    """A parameter and its values.

    Attributes:
        variable: what free runs are given.
        members: group -> name of the parameter that is its value.
        traces: name of a recording -> its group; any other has the mean of all values.
    """

    variable: str
    members: Mapping[str, str]
    traces: Mapping[str, str]

    def own(self, trace: str) -> str | None:
        """The parameter that a recording's windows have, None where they have the mean."""
        group = self.traces.get(trace)
        return None if group is None else self.members[group]

    def value(self, trace: str, values: Mapping[str, float]) -> float:
        """What a recording's windows are given, of the values of all parameters."""
        own = self.own(trace)
        return sum(values[name] for name in self.members.values()) / len(self.members) if own is None else values[own]

    def slopes(self, trace: str, slopes: Mapping[str, float]) -> float:
        """How fast that moves, of how fast parameters do."""
        return self.value(trace, dict.fromkeys(self.members.values(), 0.0) | dict(slopes))


def own_values(grouped: Iterable[Grouped], trace: str, values: Mapping[str, float]) -> dict[str, float]:
    """Values by parameter as those that a recording's windows are given."""
    own = dict(values)
    for one in grouped:
        value = one.value(trace, values)
        for name in one.members.values():
            del own[name]
        own[one.variable] = value
    return own


def own_slopes(grouped: Iterable[Grouped], trace: str, slopes: Mapping[str, float]) -> dict[str, float]:
    """Slopes by parameter as those of the values that a recording's windows are given; what stays is not among them."""
    own = dict(slopes)
    for one in grouped:
        moved = [name for name in one.members.values() if own.pop(name, None) is not None]
        if moved and (slope := one.slopes(trace, {name: slopes[name] for name in moved})):
            own[one.variable] = slope
    return own


def parted(
    parameters: ParameterSet, asked: Mapping[str, Grouping], fitted: Sequence[str], kept: Mapping[str, str]
) -> tuple[ParameterSet, tuple[Grouped, ...]]:
    """The parameters with one for each group in the place of those that are asked for, and what is tied to these.

    Args:
        asked: parameter -> how.
        fitted: names of the recordings that are fitted.
        kept: name of a recording that is not -> that which it is a part of, or its own.

    Raises:
        ScenarioError: a group names a recording that there is not or that is in another one, or one is in none.
    """
    found = {name: _grouped(name, how, fitted, kept) for name, how in asked.items()}
    for tie in parameters.ties:
        if tie.other in found:
            of = found[tie.other]
            found[tie.name] = replace(of, variable=tie.name, members=_members(tie.name, of.members))
    free: list[Parameter] = []
    for parameter in parameters.parameters:
        members = found[parameter.name].members.values() if parameter.name in found else (parameter.name,)
        free += [replace(parameter, name=name) for name in members]
    ties: list[Tie] = []
    for tie in parameters.ties:
        groups = found[tie.name].members if tie.name in found else {}
        ties += [replace(tie, name=name, other=found[tie.other].members[group]) for group, name in groups.items()]
        ties += [] if groups else [tie]
    around = tuple(
        Around(tuple(found[name].members.values()), how.around) for name, how in asked.items() if how.around is not None
    )
    return ParameterSet(tuple(free), tuple(ties), around), tuple(found.values())


def as_found(variable: str, how: Grouping, groups: Iterable[str], parts: Mapping[str, str]) -> Grouped:
    """A parameter as an earlier calibration has told it apart, for any recordings.

    Args:
        groups: those that have a value.
        parts: name of a part of a recording -> that recording.
    """
    members = _members(variable, groups)
    traces = {PurePath(one).stem: group for group, names in (how.groups or {}).items() for one in names}
    traces |= {one: group for group, names in (how.groups or {}).items() for one in names}
    traces |= {} if how.groups is not None else {group: group for group in members}
    traces |= {part: traces[whole] for part, whole in parts.items() if whole in traces}
    return Grouped(variable, members, traces)


def _members(variable: str, groups: Iterable[str]) -> dict[str, str]:
    return {group: f"{variable}{MARK}{group}" for group in groups}


def _grouped(name: str, how: Grouping, fitted: Sequence[str], kept: Mapping[str, str]) -> Grouped:
    place = f"parameters.{name}.by"
    if how.groups is None:
        traces = {trace: trace for trace in fitted} | {part: whole for part, whole in kept.items() if whole in fitted}
        return Grouped(name, _members(name, fitted), traces)
    known, traces = {*fitted, *kept, *kept.values()}, dict[str, str]()
    for group, names in how.groups.items():
        for written in names:
            trace = written if written in known else PurePath(written).stem
            if trace not in known:
                there = ", ".join(sorted({*fitted, *kept}))
                raise ScenarioError(f"{place}.{group}", f"there is no recording '{written}'", f"there are {there}")
            if traces.setdefault(trace, group) != group:
                raise ScenarioError(f"{place}.{group}", f"{trace} is in {traces[trace]}, too", "leave it in one")
        if not any(traces.get(trace) == group for trace in fitted):
            raise ScenarioError(f"{place}.{group}", "holds no recording that is fitted", "add one, or leave it out")
    for trace in fitted:
        if trace not in traces:
            raise ScenarioError(place, f"recording {trace} is in no group", f"add it to one of {', '.join(how.groups)}")
    traces |= {part: traces[whole] for part, whole in kept.items() if part not in traces and whole in traces}
    return Grouped(name, _members(name, how.groups), traces)
