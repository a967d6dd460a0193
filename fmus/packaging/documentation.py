"""documentation/index.html of an FMU: what the model is, its equations, its variables, where they come from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape

import sympy
from sympy.printing.mathml import MathMLPresentationPrinter

from fmus.model import Model
from fmus.packaging.interface import Exposed, Interface
from fmus.symbolic import trace

_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
table { border-collapse: collapse; } th, td { text-align: left; padding: .2rem .8rem; border-bottom: 1px solid #8886; }
math { display: block; overflow-x: auto; margin: .8rem 0; }
"""
_SECTIONS = (
    ("derivatives", "Rates of the continuous states"),
    ("update", "Sampled states, at each sample"),
    ("outputs", "Outputs"),
)


def page(interface: Interface) -> bytes:
    """The page; it needs nothing from the network."""
    model = interface.model
    parts = [
        f"<h1>{escape(model.name)}</h1><p>{escape(model.description)}</p>",
        *_equations(model),
        "<h2>Variables</h2>",
        _table(("Name", "Unit", "Kind", "Default", "Bounds", "Meaning"), map(_row, interface.variables)),
        *_stepping(model),
        *_list("Requirements at the start; the reason when one does not hold", [r.reason for r in model.requirements]),
        *_list("References", model.references),
    ]
    text = (f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{escape(model.name)}</title>'
            f"<style>{_STYLE}</style></head>\n<body>\n" + "\n".join(parts) + "\n</body></html>\n")  # fmt: skip
    return text.encode()


def _equations(model: Model) -> list[str]:
    traced = trace(model)
    parts = []
    for label, title in _SECTIONS:
        expressions: Mapping[str, sympy.Expr] = getattr(traced, label)
        if expressions:
            parts.append(f"<h2>{title}</h2>")
            parts += [_equation(name, expression, label) for name, expression in expressions.items()]
    return parts


def _equation(name: str, expression: sympy.Expr, label: str) -> str:
    left = f"<mi>{escape(name)}</mi>"
    if label == "derivatives":
        left = f"<mfrac><mrow><mi>d</mi>{left}</mrow><mrow><mi>d</mi><mi>t</mi></mrow></mfrac>"
    if label == "update":
        left = f"<msub>{left}<mi>new</mi></msub>"
    printer = _Printer()
    right = printer.dom.createElement("mrow")
    right.appendChild(printer._print(expression))
    return f'<math display="block">{left}<mo>=</mo>{right.toxml()}</math>'


class _Printer(MathMLPresentationPrinter):
    """Names stay whole: an underscore is no subscript here."""

    def _print_Symbol(self, sym: sympy.Symbol, style: str = "plain") -> object:  # noqa: N802
        element = self.dom.createElement("mi")
        element.appendChild(self.dom.createTextNode(sym.name))
        return element


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
        lines.append("Co-simulation: classical Runge-Kutta method with equal inner steps, inputs held over a step. "
                     "Longest inner step: " + (about or "see sources/model.c"))  # fmt: skip
    return _list("Stepping", lines)


def _list(title: str, lines: Sequence[str]) -> list[str]:
    if not lines:
        return []
    return [f"<h2>{title}</h2>", "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"]


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    head = "".join(f"<th>{escape(each)}</th>" for each in heads)
    body = "\n".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><tr>{head}</tr>\n{body}</table>"
