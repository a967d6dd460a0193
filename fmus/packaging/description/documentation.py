"""documentation/index.html of an FMU: what the model is, its equations, its variables, where they come from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache
from html import escape

import sympy
from sympy.printing.mathml import MathMLPresentationPrinter

from fmus.modelling.model import Model, element
from fmus.modelling.symbolic import trace
from fmus.packaging.description.interface import DescribedInterface, Exposed, ModelInterface

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; } th, td { text-align: left; padding: .2rem .8rem; border-bottom: 1px solid #8886; }
math { display: block; overflow-x: auto; margin: .8rem 0; }
"""
_LONG = 12  # operations and operands of a part, from which on it gets a name where it occurs twice
_SECTIONS = (
    ("derivatives", "Rates of the continuous states"),
    ("update", "Sampled states, at each sample"),
    ("outputs", "Outputs"),
)


def page(interface: ModelInterface) -> bytes:
    """The page; it needs nothing from the network."""
    model = interface.model
    parts = [
        f"<h1>{escape(model.name)}</h1><p>{escape(model.description)}</p>",
        *_equations(model),
        "<h2>Variables</h2>",
        variables(interface),
        *_stepping(model),
        *_list("Requirements at the start; the reason when one does not hold", [r.reason for r in model.requirements]),
        *_list("References", model.references),
    ]
    return document(model.name, parts)


def document(title: str, parts: Iterable[str]) -> bytes:
    """The page of these parts of HTML."""
    text = (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(title)}</title>'
        f"<style>{_STYLE}</style></head>\n<body>\n" + "\n".join(parts) + "\n</body></html>\n"
    )
    return text.encode()


def variables(interface: DescribedInterface) -> str:
    """The table of an FMU's variables."""
    return table(("Name", "Unit", "Kind", "Default", "Bounds", "Meaning"), _rows(interface))


@cache
def _equations(model: Model) -> tuple[str, ...]:
    """Parts of the page that other values do not change; to write them takes longer than all else once compiled."""
    traced = trace(model)
    parts: list[str] = []
    for label, title in _SECTIONS:
        expressions: Mapping[str, sympy.Expr] = getattr(traced, label)
        if expressions:
            printer = _Printer(_shared(expressions.values()))
            parts.append(f"<h2>{title}</h2>")
            parts += [printer.equation(_left(name, label), expression) for name, expression in expressions.items()]
            parts += printer.definitions()
    return tuple(parts)


def _left(name: str, label: str) -> str:
    """What an equation says something about."""
    left = f"<mi>{escape(name)}</mi>"
    if label == "derivatives":
        return f"<mfrac><mrow><mi>d</mi>{left}</mrow><mrow><mi>d</mi><mi>t</mi></mrow></mfrac>"
    return f"<msub>{left}<mi>new</mi></msub>" if label == "update" else left


def _shared(expressions: Iterable[sympy.Expr]) -> dict[sympy.Basic, str]:
    """Names of the parts that occur more than once and are long; parts come before what they are parts of."""
    uses: Counter[sympy.Basic] = Counter()
    sizes: dict[sympy.Basic, int] = {}

    def size(node: sympy.Basic) -> int:
        uses[node] += 1
        if node not in sizes:
            sizes[node] = 1 + sum(map(size, node.args))
        return sizes[node]

    for expression in expressions:
        size(expression)
    long = [node for node in sizes if uses[node] > 1 and sizes[node] >= _LONG and isinstance(node, sympy.Expr)]
    return {node: f"w{number}" for number, node in enumerate(long, start=1)}


class _Printer(MathMLPresentationPrinter):
    """Names stay whole: an underscore is no subscript here. Shared parts go by their names."""

    def __init__(self, shared: Mapping[sympy.Basic, str]) -> None:
        super().__init__()
        self._shared = shared

    def equation(self, left: str, expression: sympy.Basic) -> str:
        right = self.dom.createElement("mrow")
        right.appendChild(super()._print(expression))
        return f'<math display="block">{left}<mo>=</mo>{right.toxml()}</math>'

    def definitions(self) -> list[str]:
        """The shared parts, under a heading where there are any."""
        parts = [self.equation(f"<mi>{name}</mi>", node) for node, name in self._shared.items()]
        return ["<p>with</p>", *parts] if parts else []

    def _print(self, expr: sympy.Basic, **settings: object) -> object:
        if expr in self._shared:
            return self._name(self._shared[expr])
        return super()._print(expr, **settings)

    def _print_Symbol(self, sym: sympy.Symbol, style: str = "plain") -> object:  # noqa: N802
        return self._name(sym.name)

    def _print_dot(self, expr: sympy.Basic) -> object:
        half = len(expr.args) // 2
        return self._print(sympy.Add(*map(sympy.Mul, expr.args[:half], expr.args[half:]), evaluate=False))

    def _name(self, text: str) -> object:
        element = self.dom.createElement("mi")
        element.appendChild(self.dom.createTextNode(text))
        return element


def _rows(interface: DescribedInterface) -> Iterator[list[str]]:
    """One row a variable; an array has one row, with its size as default."""
    for variable in interface.variables:
        name, place = element(variable.name) or ("", ())
        if name not in interface.arrays:
            yield _row(variable)
        elif set(place) == {1}:
            size = " x ".join(map(str, interface.arrays[name]))
            yield [name, variable.unit, variable.causality, size, "", variable.description]


def _row(variable: Exposed) -> list[str]:
    low = "" if variable.minimum is None else f"{variable.minimum:g}"
    high = "" if variable.maximum is None else f"{variable.maximum:g}"
    choices = "".join(f" {number}: {name};" for number, name in enumerate(variable.choices, start=1)).rstrip(";")
    start = "" if variable.start is None else str(variable.start)
    bounds = f"{low} to {high}" if low or high else ""
    return [variable.name, variable.unit, variable.causality, start, bounds, variable.description + choices]


def _stepping(model: Model) -> list[str]:
    lines = []
    if model.sampled:
        lines.append(f"Sampled states change at the start + k {model.sample_time}, with the inputs of that instant.")
    if model.solver_step is not None and model.continuous:
        about = " ".join((model.solver_step.__doc__ or "").split())
        lines.append(
            "Co-simulation: classical Runge-Kutta method with equal inner steps, inputs held over a step. "
            "Longest inner step: " + (about or "see sources/model.c")
        )
    return _list("Stepping", lines)


def _list(title: str, lines: Sequence[str]) -> list[str]:
    if not lines:
        return []
    return [f"<h2>{title}</h2>", "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"]


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """An HTML table of texts."""
    head = "".join(f"<th>{escape(title)}</th>" for title in heads)
    body = "\n".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><tr>{head}</tr>\n{body}</table>"
