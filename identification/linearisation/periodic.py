"""Components in continuous time and components with one sample period, joined over that period.

At an instant those that sample see what the others show just before it, and each other's new outputs; what they give
out is held until the next instant, and so is what drives the system from outside.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fmus.errors import IdentificationError
from identification.linear.model import LinearModel
from identification.linearisation.interconnection import blocks, connected, held, reached_and_seen
from identification.linearisation.slopes import Sampling, Slopes
from orchestrator.system import Connection, Endpoint
from orchestrator.trace import ComplexArray, FloatArray


@dataclass(frozen=True, eq=False)
class JoinedSystem:
    """A joined system.

    Attributes:
        model: of what its inputs reach and its outputs show.
        whole: its eigenvalues, hidden ones and all.
    """

    model: LinearModel
    whole: ComplexArray

    @property
    def hidden(self) -> int:
        """Number of its states that no input reaches or no output shows, and that are not merely held values."""
        return int(np.count_nonzero(np.abs(self.whole) > 1e-9)) - int(
            np.count_nonzero(np.abs(self.model.eigenvalues) > 1e-9)
        )


def over_a_period(
    between: Mapping[str, Slopes],
    at_instants: Mapping[str, Sampling],
    connections: Sequence[Connection],
    inputs: Mapping[str, Sequence[Connection]],
    outputs: Mapping[str, Endpoint],
    step: float,
    place: str,
) -> JoinedSystem:
    """The system from inputs to outputs over a period `step` [s].

    Args:
        between: component -> what it does in continuous time (one model each).
        at_instants: component -> what it samples; a component may have both: one that only passes on does at instants
            what it does in between.
        inputs: name -> what it drives; sources are not looked at.

    Raises:
        IdentificationError: circles of direct feed-through that have no solution.
    """
    flow, instants = _Ports(between), _Ports(at_instants)
    drives = np.zeros((len(flow.ins), len(instants.outs) + len(inputs)))  # of what is held: new outputs, inputs
    inner = np.zeros((len(flow.ins), len(flow.outs)))
    seen = np.zeros((len(instants.ins), len(flow.outs)))
    at_once = np.zeros((len(instants.ins), len(instants.outs) + len(inputs)))
    for link in connections:
        for target, of_flow, of_instants in ((flow, inner, drives), (instants, seen, at_once)):
            if link.target in target.ins:
                row, own = target.ins.index(link.target), target.outs
                if link.source in flow.outs and (own is flow.outs or link.source not in own):
                    of_flow[row, flow.outs.index(link.source)] += link.factor
                elif link.source in instants.outs:
                    of_instants[row, instants.outs.index(link.source)] += link.factor
    for column, links in enumerate(inputs.values(), start=len(instants.outs)):
        for link in links:
            for target, matrix in ((flow, drives), (instants, at_once)):
                if link.target in target.ins:
                    matrix[target.ins.index(link.target), column] += link.factor
    a, b, c, d = (matrix[0] for matrix in connected(between, inner, drives, place))
    moved, driven = (matrix[0] for matrix in held(a[None], b[None], step))
    sampled = [blocks([getattr(part, name)[None] for part in at_instants.values()])[0] for name in "abcd"]
    whole = _whole((moved, driven, c, d), sampled, seen, at_once, place)
    rows = [(flow.outs + instants.outs).index(end) for end in outputs.values()]
    za, zb, zc, zd = whole[0], whole[1], whole[2][rows], whole[3][rows]
    a, b, c = (matrix[0] for matrix in reached_and_seen(za[None], zb[None], zc[None]))
    model = LinearModel(a, b, c, zd, step, tuple(inputs), tuple(outputs))
    return JoinedSystem(model, np.linalg.eigvals(za).astype(complex))


class _Ports:
    """Inputs and outputs of components, in order."""

    def __init__(self, parts: Mapping[str, Slopes] | Mapping[str, Sampling]) -> None:
        self.ins = [Endpoint(name, variable) for name, part in parts.items() for variable in part.inputs]
        self.outs = [Endpoint(name, variable) for name, part in parts.items() for variable in part.outputs]


def _whole(
    flow: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    sampled: Sequence[FloatArray],
    seen: FloatArray,
    at_once: FloatArray,
    place: str,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The map from one instant to the next of [x, sampled states, what was held before], and all outputs.

    Args:
        flow: states over the period, and outputs in continuous time, by states and what is held.
        sampled: a, b, c, d of all that sample.
        seen, at_once: inputs of those that sample, by outputs in continuous time and by what is held from now on.
    """
    (phi, gamma, c, d), (f, g, h, k) = flow, sampled
    n, s, v, w = len(phi), len(f), len(h), gamma.shape[1]
    past = np.hstack([seen @ c, np.zeros((len(seen), s)), seen @ d])  # inputs of those that sample, before they act
    around = np.eye(v) - k @ at_once[:, :v]
    if v and abs(np.linalg.det(around)) < 1e-12:
        raise IdentificationError(place, "has a circle of direct feed-through without a solution", "break it up")
    outside = at_once[:, v:]
    by_past = k @ past
    by_past[:, n : n + s] += h
    new = np.linalg.solve(around, np.hstack([by_past, k @ outside]))  # their outputs, by z and by inputs
    size = n + s + w
    holds = np.vstack([new, np.hstack([np.zeros((w - v, size)), np.eye(w - v)])])  # from now on
    takes = np.hstack([past, outside]) + at_once[:, :v] @ new
    to_x = np.hstack([phi, np.zeros((n, s + w)), np.zeros((n, w - v))]) + gamma @ holds
    to_sampled = np.hstack([np.zeros((s, n)), f, np.zeros((s, w)), np.zeros((s, w - v))]) + g @ takes
    following = np.vstack([to_x, to_sampled, holds])
    shows = np.vstack([np.hstack([c, np.zeros((len(c), s + w + w - v))]) + d @ holds, new])
    return following[:, :size], following[:, size:], shows[:, :size], shows[:, size:]
