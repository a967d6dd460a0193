"""SymPy expressions as C: one statement a shared or long sub-expression, and every operation in the order it has.

An expression traced as it is written gives C that computes what Python computes, to the last bit but for x**2.
"""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce

import sympy
from sympy.core.function import AppliedUndef
from sympy.logic.boolalg import Boolean, BooleanFalse, BooleanTrue

from fmus.errors import ModelError

LONGEST = 88  # characters of an expression, before its longest part is given a name

Text = tuple[str, int]  # C, and how tightly it binds
_TERNARY, _SUM, _PRODUCT, _ATOM = range(4)
# SymPy turns floor(x) > 1 into x >= ceiling(1 + 1), whence ceiling.
_FUNCTIONS = {
    "sin": "sin",
    "cos": "cos",
    "tan": "tan",
    "tanh": "tanh",
    "exp": "exp",
    "log": "log",
    "floor": "floor",
    "Abs": "fabs",
    "sign": "sign",
    "uniform": "uniform",
    "ceiling": "ceil",
    "Not": "!",
}
_FOLDED = {"Min": "minimum", "Max": "maximum"}
_JOINED = {"And": " && ", "Or": " || "}


class UnknownOperationError(Exception):
    """An operation without a counterpart in C; the message is its name."""


@dataclass(frozen=True)
class Dialect:
    """What the names in expressions are in C.

    Attributes:
        symbols: C of each symbol.
        tables: names of the tables, in the order of the C array `tables`.
        references: place in the C array `v` of each symbol that is an element of an array.
        computed: C of expressions whose values are there already.
    """

    symbols: Mapping[sympy.Symbol, str]
    tables: Sequence[str] = ()
    references: Mapping[sympy.Symbol, int] = field(default_factory=dict)
    computed: Mapping[sympy.Basic, str] = field(default_factory=dict)


def statements(place: str, dialect: Dialect, roots: Sequence[sympy.Basic]) -> tuple[list[str], list[str]]:
    """Lines that declare named sub-expressions, and for each root the C that gives its value after them.

    Args:
        place: where the expressions come from, for errors.

    Raises:
        ModelError: an operation that the generator does not know.
    """
    writer = _Writer(dialect, _uses(roots))
    try:
        for root in roots:
            writer.prepare(root)
        return writer.lines, [writer.text(root)[0] for root in roots]
    except UnknownOperationError as unknown:
        raise ModelError(place, f"uses '{unknown}', which has no counterpart in C", "use only fmus.ops") from None


def computed_from(symbols: Iterable[sympy.Basic], roots: Iterable[sympy.Basic]) -> list[sympy.Basic]:
    """The largest numbers in these expressions that hold no other symbols, each once, in their order."""
    allowed, found = set(symbols), dict[sympy.Basic, None]()
    within: dict[sympy.Basic, bool] = {}

    def is_within(node: sympy.Basic) -> bool:
        if node not in within:
            operands = list(_operands(node))
            within[node] = all([*map(is_within, operands)]) if operands else not node.is_Symbol or node in allowed
        return within[node]

    def visit(node: sympy.Basic) -> None:
        if node.is_Atom or node in found:
            return
        if is_within(node) and not isinstance(node, Boolean):
            found[node] = None
        elif node not in seen:
            seen.add(node)
            for operand in _operands(node):
                visit(operand)

    seen = set[sympy.Basic]()
    for root in roots:
        visit(root)
    return list(found)


def literal(value: float) -> str:
    """A double of C with every bit."""
    text = repr(float(value))
    return {"inf": "INFINITY", "-inf": "-INFINITY", "nan": "NAN"}.get(text, text)


def string(text: str) -> str:
    """A string literal of C, in UTF-8."""
    escaped = (f"\\{byte:03o}" if byte < 32 or byte > 126 or byte in b'"\\?' else chr(byte) for byte in text.encode())
    return '"' + "".join(escaped) + '"'


class _Writer:
    def __init__(self, dialect: Dialect, uses: Counter[sympy.Basic]) -> None:
        self.lines: list[str] = []
        self._tables, self._uses, self._references = list(dialect.tables), uses, dialect.references
        self._vectors: dict[tuple[sympy.Basic, ...], str] = {}
        known = {**dialect.symbols, **dialect.computed}
        self._texts: dict[sympy.Basic, Text] = {node: (name, _ATOM) for node, name in known.items()}

    def prepare(self, node: sympy.Basic) -> None:
        """Give names to what is used twice or too long, children first."""
        if node in self._texts or node.is_Atom:
            return
        for child in _operands(node):
            self.prepare(child)
        self._texts[node] = self._short(node)
        if self._uses[node] > 1 and not isinstance(node, Boolean):
            self._give_name(node)

    def _short(self, node: sympy.Basic) -> Text:
        """The node's C, once its longest operands have got names if it would be a long line without."""
        text = self._compose(node)
        parts = sorted(
            (operand for operand in _operands(node) if not isinstance(operand, Boolean) and not operand.is_Atom),
            key=lambda operand: len(self.text(operand)[0]),
            reverse=True,
        )
        for part in parts:
            if len(text[0]) <= LONGEST or len(self.text(part)[0]) < LONGEST // 4:
                break
            self._give_name(part)
            text = self._compose(node)
        return text

    def _give_name(self, node: sympy.Basic) -> None:
        name = f"w{len(self.lines)}"
        self.lines.append(f"const double {name} = {self._texts[node][0]};")
        self._texts[node] = (name, _ATOM)

    def text(self, node: sympy.Basic) -> Text:
        return self._texts[node] if node in self._texts else self._compose(node)

    def _bound(self, node: sympy.Basic, binding: int) -> str:
        """The node's C, in parentheses where it binds less than this."""
        text, own = self.text(node)
        return text if own >= binding else f"({text})"

    def _compose(self, node: sympy.Basic) -> Text:
        for kind, compose in (
            ("is_Add", self._sum),
            ("is_Mul", self._product),
            ("is_Pow", self._power),
            ("is_Piecewise", self._choice),
            ("is_Relational", self._relation),
        ):
            if getattr(node, kind):
                return compose(node)
        return _constant(node) if node.is_Atom else self._call(node)

    def _sum(self, node: sympy.Add) -> Text:
        terms = list(node.args)
        if _negated(terms[0]) and not _negated(terms[1]):
            terms[:2] = terms[1], terms[0]
        text = self._bound(terms[0], _SUM)
        for term in terms[1:]:
            if _negated(term):
                text += " - " + self._factors(*_without_sign(term))
            else:
                text += " + " + self._bound(term, _PRODUCT)
        return text, _SUM

    def _product(self, node: sympy.Mul) -> Text:
        if not _negated(node):
            return self._factors(1, node.args), _PRODUCT
        return "-" + self._factors(*_without_sign(node)), _SUM

    def _factors(self, number: float, factors: Sequence[sympy.Basic]) -> str:
        """number * factors, one after the other."""
        text = "" if number == 1 and factors else literal(number)
        for factor in factors:
            denominator = _denominator(factor)
            if denominator is not None:
                text = (text or "1.0") + " / " + self._denominator(*denominator)
            else:
                text += (" * " if text else "") + self._bound(factor, _ATOM if text else _PRODUCT)
        return text

    def _denominator(self, base: sympy.Basic, power: sympy.Rational) -> str:
        return self._bound(base, _ATOM) if power == 1 else self._root_or_power(base, power)

    def _power(self, node: sympy.Pow) -> Text:
        denominator = _denominator(node)
        if denominator is not None:
            return "1.0 / " + self._denominator(*denominator), _PRODUCT
        return self._root_or_power(node.base, node.exp), _ATOM

    def _root_or_power(self, base: sympy.Basic, power: sympy.Basic) -> str:
        if power == 2:
            return f"square({self.text(base)[0]})"
        if power == sympy.Rational(1, 2):
            return f"sqrt({self.text(base)[0]})"
        return f"pow({self.text(base)[0]}, {self.text(power)[0]})"

    def _relation(self, node: sympy.Rel) -> Text:
        return f"{self._bound(node.lhs, _SUM)} {node.rel_op} {self._bound(node.rhs, _SUM)}", _TERNARY

    def _choice(self, node: sympy.Piecewise) -> Text:
        *others, last = node.args
        if last.cond is not sympy.true:
            raise UnknownOperationError("Piecewise without a last case")
        text = self._bound(last.expr, _SUM)
        for piece in reversed(others):
            condition, value = self.text(piece.cond)[0], self._bound(piece.expr, _SUM)
            text = f"({condition} ? {value} : {text})"
        return text, _ATOM

    def _call(self, node: sympy.Basic) -> Text:
        name = type(node).__name__
        if name in _JOINED:
            return _JOINED[name].join(f"({self.text(condition)[0]})" for condition in node.args), _TERNARY
        if name == "dot":
            return self._dot(node.args), _ATOM
        arguments = [self.text(argument)[0] for argument in node.args]
        if name in _FOLDED:
            return reduce(lambda so_far, argument: f"{_FOLDED[name]}({so_far}, {argument})", arguments), _ATOM
        function = self._table(name) or f"{self._function(node, name)}("
        return f"{function}{', '.join(arguments)})", _ATOM

    def _dot(self, arguments: Sequence[sympy.Basic]) -> str:
        size = len(arguments) // 2
        a, b = self._vector(tuple(arguments[:size])), self._vector(tuple(arguments[size:]))
        return f"dot({size}, {a}, {b})"

    def _vector(self, parts: tuple[sympy.Basic, ...]) -> str:
        """C of a pointer to these values: into `v` where they lie there side by side, else to an array of their own."""
        places = [self._references.get(part, -1) for part in parts]
        if places[0] >= 0 and places == list(range(places[0], places[0] + len(parts))):
            return "&" + self.text(parts[0])[0]
        if parts not in self._vectors:
            values = textwrap.wrap(", ".join(self.text(part)[0] for part in parts), 100)
            name = self._vectors[parts] = f"w{len(self.lines)}"
            self.lines.append(f"const double {name}[] = {{" + "\n        ".join(values) + "};")
        return self._vectors[parts]

    @staticmethod
    def _function(node: sympy.Basic, name: str) -> str:
        if name not in _FUNCTIONS or (isinstance(node, AppliedUndef) and name != "uniform"):
            raise UnknownOperationError(name)
        return _FUNCTIONS[name]

    def _table(self, name: str) -> str:
        """The beginning of a call that plays a table back, or gives its slope; nothing for other functions."""
        for function in ("playback_slope", "playback"):
            table = name.removeprefix(f"{function}_")
            if table != name and table in self._tables:
                return f"{function}(&tables[{self._tables.index(table)}], "
        return ""


def _uses(roots: Sequence[sympy.Basic]) -> Counter[sympy.Basic]:
    """How often each sub-expression is an operand of others, or a root."""
    uses: Counter[sympy.Basic] = Counter(roots)
    waiting, seen = list(roots), set(roots)
    while waiting:
        for child in _operands(waiting.pop()):
            uses[child] += 1
            if child not in seen:
                seen.add(child)
                waiting.append(child)
    return uses


def _operands(node: sympy.Basic) -> Iterator[sympy.Basic]:
    """What a node's C contains; signs and denominators are part of the sum or product they stand in."""
    if node.is_Piecewise:
        for piece in node.args:
            yield piece.expr
            yield piece.cond
    elif node.is_Add:
        for term in node.args:
            if _negated(term) and not term.is_Number:
                yield from _without_denominators(_without_sign(term)[1])
            else:
                yield term
    elif node.is_Mul:
        yield from _without_denominators(_without_sign(node)[1] if _negated(node) else node.args)
    elif node.is_Pow:
        yield from _without_denominators((node,)) if _denominator(node) else node.args
    else:
        yield from node.args


def _without_denominators(factors: Sequence[sympy.Basic]) -> Iterator[sympy.Basic]:
    for factor in factors:
        denominator = _denominator(factor)
        yield factor if denominator is None else denominator[0]


def _negated(term: sympy.Basic) -> bool:
    """Whether a term is a negative number, or a product that begins with one."""
    return bool((term.is_Number and term < 0) or (term.is_Mul and term.args[0].is_Number and term.args[0] < 0))


def _without_sign(term: sympy.Basic) -> tuple[float, Sequence[sympy.Basic]]:
    """A negated term as the number and the factors whose product is its opposite."""
    if term.is_Number:
        return -float(term), ()
    return -float(term.args[0]), term.args[1:]


def _denominator(factor: sympy.Basic) -> tuple[sympy.Basic, sympy.Rational] | None:
    """(b, n) of a factor b**-n, for the n that C has a short form for."""
    if factor.is_Pow and factor.exp in (-1, -2, sympy.Rational(-1, 2)):
        return factor.base, -factor.exp
    return None


def _constant(node: sympy.Basic) -> Text:
    if isinstance(node, BooleanTrue | BooleanFalse):
        return ("1" if node else "0"), _ATOM
    if not (node.is_Number or node.is_NumberSymbol) or node is sympy.nan or node is sympy.zoo:
        raise UnknownOperationError(str(node))
    return literal(float(node)), _ATOM if node >= 0 else _SUM
