"""A linear, discrete-time model of any size: x[k+1] = A x[k] + B u[k], y[k] = C x[k] + D u[k].

Its matrices are parameters, so that an identified model is an FMU. It is a sampled plant: the outputs of an instant are
there before its inputs are, and its inputs act on them one instant later (at once where there is a D). One that was
found about a point has that as parameters: u counts from u_zero, y from y_zero.
"""

from functools import lru_cache

from . import Model, State, array, input_, ops, output, parameter

EARLY = 1e-6  # of a sample period, as the instants of samples are found by
NEVER = -1e300
POINT = "What the matrices are about"


def state_space(order, inputs, outputs, direct=False, about=False):
    """A model with these inputs and outputs (name -> unit) and all matrices zero; with D where `direct`.

    Args:
        about: whether it has u_zero and y_zero.

    Raises:
        ValueError: a size of 0, or a name that a state or another variable has.
    """
    return _state_space(order, tuple(inputs.items()), tuple(outputs.items()), direct, about)


def matrices(a, b, c, d=None, start=None, zero=None):
    """Parameter -> value of these matrices (rows of numbers), the state at the start, and the (u, y) they are about."""
    values = {f"x_start[{i}]": float(value) for i, value in enumerate([] if start is None else start, start=1)}
    for name, matrix in (("A", a), ("B", b), ("C", c), ("D", [] if d is None else d)):
        for i, row in enumerate(matrix, start=1):
            values |= {f"{name}[{i},{j}]": float(value) for j, value in enumerate(row, start=1)}
    for name, point in zip(("u_zero", "y_zero"), zero or ([], []), strict=True):
        values |= {f"{name}[{i}]": float(value) for i, value in enumerate(point, start=1)}
    return values


@lru_cache(maxsize=32)
def _state_space(order, inputs, outputs, direct, about):
    states = [f"x_{i}" for i in range(1, order + 1)]
    held = [f"held_{i}" for i in range(1, len(outputs) + 1)]
    names_in, names_out = [name for name, _ in inputs], [name for name, _ in outputs]
    if not (order > 0 and inputs and outputs) or {*names_in, *names_out} & {*states, *held, "sampled_at"}:
        raise ValueError(f"no model of order {order} with inputs {names_in} and outputs {names_out}")

    def state(x):
        return [getattr(x, name) for name in states]

    def driving(u, p):
        values = [getattr(u, name) for name in names_in]
        return [value - zero for value, zero in zip(values, p.u_zero, strict=True)] if about else values

    def update(t, x, u, p):
        """The state becomes that of the next instant; until then, what the present one gives to the outputs is held."""
        following = [ops.dot(a, state(x)) + ops.dot(b, driving(u, p)) for a, b in zip(p.A, p.B, strict=True)]
        present = [ops.dot(c, state(x)) for c in p.C]
        return dict(zip([*states, *held, "sampled_at"], [*following, *present, t], strict=True))

    def shown(t, x, u, p):
        reached = t - x.sampled_at > (1 - EARLY) * p.sample_time
        kept = [getattr(x, name) for name in held]
        values = [ops.where(reached, ops.dot(c, state(x)), value) for c, value in zip(p.C, kept, strict=True)]
        if direct:
            values = [value + ops.dot(d, driving(u, p)) for value, d in zip(values, p.D, strict=True)]
        if about:
            values = [value + zero for value, zero in zip(values, p.y_zero, strict=True)]
        return dict(zip(names_out, values, strict=True))

    sizes = {"A": (order, order), "B": (order, len(inputs)), "C": (len(outputs), order)}
    sizes |= {"D": (len(outputs), len(inputs))} if direct else {}
    points = {"u_zero": len(inputs), "y_zero": len(outputs)} if about else {}
    return Model(
        name="state_space",
        description=f"Linear discrete-time model of order {order}",
        variables=(
            *(input_(name, unit, "Input") for name, unit in inputs),
            *(output(name, unit, "Output") for name, unit in outputs),
            parameter("sample_time", "s", 0.01, "Sample period", minimum=1e-6),
            *(element for name, shape in sizes.items() for element in array(name, "1", shape, f"Matrix {name}")),
            *(element for name, size in points.items() for element in array(name, "1", (size,), POINT)),
            *array("x_start", "1", (order,), "State at the start"),
        ),
        states=(
            *(State(name, f"x_start[{i}]", sampled=True) for i, name in enumerate(states, start=1)),
            *(State(name, sampled=True, description="Of an output, what the state gives to it") for name in held),
            State("sampled_at", NEVER, "s", sampled=True, description="The last sampling instant"),
        ),
        update=update,
        outputs=shown,
        sample_time="sample_time",
        plant=True,
        call=f"state_space({order}, {dict(inputs)!r}, {dict(outputs)!r}, {direct}, {about})",
        sized=lambda shapes: _state_space(shapes["A"][0], inputs, outputs, direct, about),
    )


MODEL = state_space(2, {"u": "1"}, {"y": "1"})
