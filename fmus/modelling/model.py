"""How a model declares itself: its variables, its states, and up to three pure functions.

    derivatives(t, x, u, p)   rates of the continuous states
    update(t, x, u, p)        new values of the sampled states, at t = 0, sample_time, 2 sample_time, ...
    outputs(t, x, u, p)       outputs that are not states themselves

`t` is the time [s]; `x`, `u` and `p` give states, inputs and parameters by name (`x.angle`); each function returns a
dict by name. They may call only `fmus.ops`, so that one source runs as floats and is traced as symbols. Parameters
named `A[1,1]`, `A[1,2]`, ... are the elements of an array, which comes as nested lists: `p.A[0][1]`. The file stands
alone and travels inside every Python FMU.
"""

from __future__ import annotations

import math
import re
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise, product
from keyword import iskeyword
from types import SimpleNamespace
from typing import Any

from .ports import PhysicalPort, problems

Named = dict[str, Any]
"""Name -> number, or what the equations are traced with."""
Function = Callable[[Any, Any, Any, Any], Named]
Number = float | int | bool
_ELEMENT = re.compile(r"((?:\w+\.)*\w+)\[([1-9][0-9]*(?:,[1-9][0-9]*)*)\]")


@dataclass(frozen=True)
class Variable:
    """One input, output or parameter, as importers see it.

    Attributes:
        unit: FMI unit name ("N.m", "rad/s"), "1" for a pure number.
        start: default value (inputs and parameters).
        choices: names of the values 1, 2, ... of an integer that selects.
        tunable: whether a parameter may change between two steps; of models without continuous states, whose steps
            and requirements do not depend on it.
    """

    name: str
    unit: str
    causality: str
    description: str
    start: Number | None = None
    minimum: float | None = None
    maximum: float | None = None
    nominal: float | None = None
    choices: tuple[str, ...] = ()
    tunable: bool = False

    @property
    def type(self) -> str:
        if isinstance(self.start, bool):
            return "Boolean"
        return "Integer" if isinstance(self.start, int) else "Real"


@dataclass(frozen=True)
class State:
    """A state and where it starts: at a number or at the value of the parameter of that name.

    A state that has the name of an output is that output. `sampled` states change in `update`, others by `derivatives`.
    """

    name: str
    start: str | float = 0.0
    unit: str = "1"
    sampled: bool = False
    description: str = ""


@dataclass(frozen=True)
class Delay:
    """An input that acts later than it is set.

    Over a step the model has the mean of what it was that much earlier, each value held until the next. Smooth, it is
    the curve through its values, as it was that long before the step's end.

    Attributes:
        input: name of the input; the parameters are
        seconds: how much later it acts [s],
        before: what it was before the first step, over what it is then,
        shape: an integer, 1 where it is held and 2 where it is smooth.
    """

    input: str
    seconds: str
    before: str
    shape: str


@dataclass(frozen=True)
class Requirement:
    """A condition on (t, x, u, p) that must hold when the first step begins; the reason when it does not, and a fix."""

    holds: Callable[[Any, Any, Any, Any], Any]
    reason: str


@dataclass(frozen=True)
class Table:
    """Samples over time that a model plays back: linear between samples, end values outside.

    Attributes:
        time: strictly increasing instants [s], at least one.
        values: one value an instant.
    """

    name: str
    time: Sequence[float] = (0.0,)
    values: Sequence[float] = (0.0,)

    def __post_init__(self) -> None:
        if not 0 < len(self.time) == len(self.values):
            raise ValueError(f"table {self.name}: {len(self.time)} instants for {len(self.values)} values")
        if any(not later > earlier for earlier, later in pairwise(self.time)):
            raise ValueError(f"table {self.name}: its instants do not increase strictly")

    def __call__(self, time: float) -> float:
        right = bisect_right(self.time, time)
        if right == 0:
            return self.values[0]
        if right == len(self.time):
            return self.values[-1]
        t0, t1 = self.time[right - 1], self.time[right]
        y0, y1 = self.values[right - 1], self.values[right]
        return y0 + (y1 - y0) * (time - t0) / (t1 - t0)


@dataclass(frozen=True)
class Model:
    """A model: what importers see of it, and its functions.

    Attributes:
        solver_step: (p) -> longest inner step of the fixed-step solver [s] that is accurate and stable for these
            parameters; None for models without continuous states.
        sample_time: name of the parameter that holds the sample period [s], for models with `update`.
        tables: names of the tables that come as `p.<name>`.
        references: sources of the equations.
        plant: whether the outputs of a sampled model show what an input did at the next sampling instant, as those of a
            plant; they show it at once, as those of a controller, otherwise.
        call: the expression that gives this model in the file of its functions.
        delays: the inputs that act late.
        sized: (array -> shape) -> this model with arrays of these shapes; None where they have one size only.
        ports: where it meets others, a flow and what drives it each.
        arrays: name -> shape of each array among the parameters.
    """

    name: str
    description: str
    variables: tuple[Variable, ...]
    states: tuple[State, ...] = ()
    derivatives: Function | None = None
    update: Function | None = None
    outputs: Function | None = None
    solver_step: Callable[[Any], Any] | None = None
    sample_time: str | None = None
    requirements: tuple[Requirement, ...] = ()
    tables: tuple[str, ...] = ()
    references: tuple[str, ...] = ()
    plant: bool = False
    call: str = "MODEL"
    delays: tuple[Delay, ...] = ()
    sized: Callable[[Mapping[str, tuple[int, ...]]], Model] | None = field(default=None, repr=False, compare=False)
    ports: tuple[PhysicalPort, ...] = ()
    by_name: Mapping[str, Variable] = field(init=False, repr=False, compare=False)
    arrays: Mapping[str, tuple[int, ...]] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "by_name", {variable.name: variable for variable in self.variables})
        object.__setattr__(self, "arrays", _arrays(self.variables))
        for problem in _problems(self):
            raise ValueError(f"model {self.name}: {problem}")

    def of(self, causality: str) -> tuple[Variable, ...]:
        """Variables of one causality: "input", "output" or "parameter"."""
        return tuple(variable for variable in self.variables if variable.causality == causality)

    @property
    def continuous(self) -> tuple[State, ...]:
        return tuple(state for state in self.states if not state.sampled)

    @property
    def sampled(self) -> tuple[State, ...]:
        return tuple(state for state in self.states if state.sampled)


def _problems(model: Model) -> Iterator[str]:
    """What in a model's declarations does not fit together."""
    parameters = {variable.name for variable in model.of("parameter")}
    if len(model.by_name) != len(model.variables) or len({state.name for state in model.states}) != len(model.states):
        yield "two variables or two states have one name"
    scalars = [name for name in model.by_name if element(name) is None]
    yield from _problems_of_arrays(model, {*scalars, *model.tables})
    for name in (model.name, *scalars, *model.arrays, *model.tables, *(state.name for state in model.states)):
        if not name.isidentifier() or iskeyword(name):
            yield f"'{name}' is no name; use letters, digits and underscores"
    for state in model.states:
        if isinstance(state.start, str) and state.start not in parameters:
            yield f"state '{state.name}' starts at '{state.start}', which is no parameter"
        if state.name in model.by_name and model.by_name[state.name].causality != "output":
            yield f"state '{state.name}' has the name of a variable that is no output"
    for variable in model.variables:
        yield from _problems_of_values(variable)
    yield from _problems_of_tunables(model)
    yield from _problems_of_delays(model)
    yield from problems(model.ports, {variable.name: variable.causality for variable in model.variables})
    if model.sampled and model.sample_time not in parameters:
        yield f"sampled states need a sample period, and '{model.sample_time}' is no parameter"
    if model.continuous and model.solver_step is None:
        yield "continuous states need a solver_step"


def _problems_of_tunables(model: Model) -> Iterator[str]:
    """Parameters that may not change between two steps although they are to."""
    used = {model.sample_time, *(state.start for state in model.states)}
    used |= {name for delay in model.delays for name in (delay.seconds, delay.before, delay.shape)}
    for variable in model.variables:
        if variable.tunable and (variable.causality != "parameter" or variable.name in used or model.continuous):
            yield f"'{variable.name}' cannot be tunable: states, samples or the solver's steps depend on it"


def _problems_of_delays(model: Model) -> Iterator[str]:
    """Delays of what is no real input, by what is no parameter of its kind."""
    kinds = {variable.name: (variable.causality, variable.type) for variable in model.variables}
    for delay in model.delays:
        wanted = {delay.input: ("input", "Real"), delay.seconds: ("parameter", "Real")}
        wanted |= {delay.before: ("parameter", "Real"), delay.shape: ("parameter", "Integer")}
        for name, (causality, kind) in wanted.items():
            if kinds.get(name) != (causality, kind):
                yield f"a delay needs '{name}' to be {'an' if causality == 'input' else 'a'} {causality} of type {kind}"
        seconds = model.by_name.get(delay.seconds)
        if seconds is not None and (seconds.minimum is None or seconds.minimum < 0):
            yield f"'{delay.seconds}' needs a minimum of 0: nothing acts before it is set"


def _problems_of_values(variable: Variable) -> Iterator[str]:
    """A start value or bounds that no FMU could have."""
    low = -math.inf if variable.minimum is None else variable.minimum
    high = math.inf if variable.maximum is None else variable.maximum
    start = variable.start
    if not low <= high:
        yield f"'{variable.name}' has a minimum of {low:g} and a maximum of {high:g}"
    elif start is not None and not (math.isfinite(start) and low <= start <= high):
        yield f"'{variable.name}' starts at {start:g}, which is not a finite number within its bounds"


def _problems_of_arrays(model: Model, others: set[str]) -> Iterator[str]:
    """Arrays that are not whole, in the order of their rows, and of real parameters."""
    elements = [variable for variable in model.variables if element(variable.name) is not None]
    if any(variable.causality != "parameter" or variable.type != "Real" for variable in elements):
        yield "elements of arrays must be real parameters"
    for name, shape in model.arrays.items():
        found = [at for at, variable in enumerate(model.variables) if (element(variable.name) or ("",))[0] == name]
        names = [model.variables[at].name for at in found]
        if names != list(element_names(name, shape)) or found != list(range(found[0], found[0] + len(found))):
            yield f"the elements of '{name}' are not all there, one after the other, row by row"
        if name in others:
            yield f"'{name}' is an array and something else"


def _arrays(variables: Sequence[Variable]) -> dict[str, tuple[int, ...]]:
    """Name -> shape of each array, which is the place of its last element."""
    return {found[0]: found[1] for found in (element(variable.name) for variable in variables) if found is not None}


@lru_cache(maxsize=4096)
def element(name: str) -> tuple[str, tuple[int, ...]] | None:
    """The array and the place, from 1, that the name of an element gives; None for other names."""
    match = _ELEMENT.fullmatch(name)
    return None if match is None else (match[1], tuple(map(int, match[2].split(","))))


def element_names(name: str, shape: Sequence[int]) -> tuple[str, ...]:
    """Names of an array's elements, row by row."""
    places = product(*(range(1, size + 1) for size in shape))
    return tuple(f"{name}[{','.join(map(str, place))}]" for place in places)


def element_number(place: Sequence[int], shape: Sequence[int]) -> int | None:
    """Number of an element, from 0 and row by row; None where the array has no such place."""
    if len(place) != len(shape) or any(not 0 < at <= size for at, size in zip(place, shape, strict=True)):
        return None
    number = 0
    for at, size in zip(place, shape, strict=True):
        number = number * size + at - 1
    return number


def array(
    name: str, unit: str, shape: Sequence[int], description: str, start: Sequence[float] = ()
) -> tuple[Variable, ...]:
    """The elements of an array of real parameters; `start` has them row by row, zeros by default."""
    starts = [float(value) for value in start] or [0.0] * math.prod(shape)
    elements = zip(element_names(name, shape), starts, strict=True)
    return tuple(parameter(element_name, unit, first, description) for element_name, first in elements)


def parameter(name: str, unit: str, start: Number, description: str, **limits: Any) -> Variable:
    """A parameter; limits: minimum, maximum, nominal, choices, tunable."""
    return Variable(name, unit, "parameter", description, start, **limits)


def input_(name: str, unit: str, description: str, start: float = 0.0, **limits: Any) -> Variable:
    """An input with the value it has while nothing is connected."""
    return Variable(name, unit, "input", description, start, **limits)


def output(name: str, unit: str, description: str, **limits: Any) -> Variable:
    """An output: a state of that name, or a result of `outputs`."""
    return Variable(name, unit, "output", description, **limits)


def start_values(model: Model) -> dict[str, Number]:
    """The default of every input and parameter."""
    return {variable.name: variable.start for variable in model.variables if variable.start is not None}


def namespace(values: Mapping[str, Any]) -> SimpleNamespace:
    """Values by attribute, as the model functions expect them; elements of arrays also in nested lists."""
    space = SimpleNamespace()
    for name, value in values.items():
        assign(space, name, value)
    return space


def assign(space: SimpleNamespace, name: str, value: Any) -> None:
    """Give a value to an attribute; to an element of an array in its list, too."""
    setattr(space, name, value)
    found = element(name) if "[" in name else None
    if found is None:
        return
    base, (*outer, last) = found
    level = space.__dict__.setdefault(base, [])
    for place in outer:
        level.extend([] for _ in range(len(level), place))
        level = level[place - 1]
    level.extend(None for _ in range(len(level), last))
    level[last - 1] = value
