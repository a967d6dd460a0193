"""Parameter sets (SSV) and mappings (SSM), as documents give them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from fmus.errors import FmuFileError
from fmus.units import BASES, Unit
from orchestrator.ssp.description import MappingEntry, SsvParameter, Transformation
from orchestrator.ssp.names import SSC, SSM, SSV

if TYPE_CHECKING:
    from lxml import etree

Scalar = float | int | bool | str
_WORDS = ("String", "Enumeration")  # may hold spaces, so that those of an array are elements
_TRUTH = {"true": True, "1": True, "false": False, "0": False}


def parameters(root: etree._Element, place: str) -> dict[str, SsvParameter]:
    """Name -> value of a parameter set.

    Raises:
        FmuFileError: it is none, two parameters have one name, or a value is not of its type.
    """
    if root.tag != f"{SSV}ParameterSet":
        raise FmuFileError(place, "is not an SSV parameter set", "correct its type")
    found: dict[str, SsvParameter] = {}
    for entry in root.iterfind(f"{SSV}Parameters/{SSV}Parameter"):
        name = required(entry, "name", place)
        if name in found:
            raise FmuFileError(f"{place}: {name}", "is given twice", "remove one")
        found[name] = _parameter(entry, f"{place}: {name}")
    return found


def mapping(root: etree._Element, place: str) -> tuple[MappingEntry, ...]:
    """The entries of a parameter mapping.

    Raises:
        FmuFileError: it is none, or an entry is incomplete.
    """
    if root.tag != f"{SSM}ParameterMapping":
        raise FmuFileError(place, "is not an SSM parameter mapping", "correct its type")
    return tuple(
        MappingEntry(
            required(entry, "source", place),
            required(entry, "target", place),
            transformation(entry, place),
            not truth(entry, "suppressUnitConversion", place),
        )
        for entry in root.iterfind(f"{SSM}MappingEntry")
    )


def transformation(entry: etree._Element, place: str) -> Transformation | None:
    """What a connection or a mapping entry changes its value by; None where it does not.

    Raises:
        FmuFileError: a factor or offset is no number, or a table has no entry.
    """
    linear = entry.find(f"{SSC}LinearTransformation")
    if linear is not None:
        return Transformation(number(linear, "factor", place, 1.0), number(linear, "offset", place, 0.0))
    for kind in ("Boolean", "Integer", "Enumeration"):
        table = entry.find(f"{SSC}{kind}MappingTransformation")
        if table is not None:
            rows = table.iterfind(f"{SSC}MapEntry")
            entries = tuple((required(row, "source", place), required(row, "target", place)) for row in rows)
            if not entries:
                raise FmuFileError(place, "has a mapping transformation without entries", "remove it")
            return Transformation(entries=entries)
    return None


def units(parent: etree._Element | None, place: str) -> dict[str, Unit]:
    """Name -> unit of the `Units` of a document, None where it has none.

    Raises:
        FmuFileError: an exponent or factor is none, or converts nothing.
    """
    found: dict[str, Unit] = {}
    for entry in () if parent is None else parent.iterfind(f"{SSC}Unit"):
        name, base = required(entry, "name", place), entry.find(f"{SSC}BaseUnit")
        if base is None or not base.attrib:
            continue  # what is only named may be known by its name
        here = f"{place}: unit {name}"
        exponents = [number(base, power, here, 0.0) for power in BASES]
        if not all(exponent.is_integer() for exponent in exponents):
            raise FmuFileError(here, "has an exponent that is not whole", "correct it")
        unit = Unit(number(base, "factor", here, 1.0), tuple(map(int, exponents)), number(base, "offset", here, 0.0))
        if not unit.factor:
            raise FmuFileError(here, "has a factor that converts nothing", "correct it")
        found[name] = unit
    return found


def required(entry: etree._Element, attribute: str, place: str) -> str:
    """An attribute that must be there.

    Raises:
        FmuFileError: it is not.
    """
    text = entry.get(attribute)
    if text is None:
        kind = str(entry.tag).rpartition("}")[2]
        raise FmuFileError(f"{place}:{entry.sourceline}", f"a {kind} has no `{attribute}`", "export it again")
    return str(text)


def number(entry: etree._Element, attribute: str, place: str, default: float) -> float:
    """A finite number.

    Raises:
        FmuFileError: it is none.
    """
    text = entry.get(attribute)
    try:
        value = default if text is None else float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FmuFileError(f"{place}:{entry.sourceline}", f"{attribute}='{text}' is no number", "correct it")
    return value


def truth(entry: etree._Element, attribute: str, place: str) -> bool:
    """True or false; false where it does not say.

    Raises:
        FmuFileError: it is neither.
    """
    text = entry.get(attribute, "false").strip()
    if text not in _TRUTH:
        raise FmuFileError(f"{place}:{entry.sourceline}", f"{attribute}='{text}' is no truth", "write true or false")
    return _TRUTH[text]


def _parameter(entry: etree._Element, place: str) -> SsvParameter:
    typed = next((child for child in entry.iterchildren("{*}*") if child.tag.startswith(SSV)), None)
    if typed is None:
        raise FmuFileError(place, "has no value", "write it again")
    kind = str(typed.tag).removeprefix(SSV)
    sizes = [required(size, "size", place) for size in entry.iterfind(f"{SSC}Dimension")]
    if kind == "Binary":
        raise FmuFileError(place, "is a Binary, which cannot be set", "remove it")
    try:
        values, shape = tuple(_values(typed, kind)), tuple(map(int, sizes))
    except (ValueError, KeyError):
        raise FmuFileError(place, f"'{typed.get('value')}' is no {kind}", "write the set again") from None
    if not shape and len(values) != 1:
        shape = (len(values),)
    if math.prod(shape) != len(values):
        each = kind in _WORDS and typed.get("value") is not None
        fix = f"give each as a `Value` within `{kind}`, since one may hold spaces" if each else "write the set again"
        raise FmuFileError(place, f"has {len(values)} values for {math.prod(shape)} elements", fix)
    return SsvParameter(values if shape else values[0], typed.get("unit"), shape, entry.sourceline or 0)


def _values(typed: etree._Element, kind: str) -> Iterator[Scalar]:
    """All that a value holds: one number, or those of an array.

    Raises:
        ValueError, KeyError: one is not of the type.
    """
    if kind in _WORDS:
        single = typed.get("value")
        yield from (one.attrib["value"] for one in typed.iterfind("{*}Value")) if single is None else [single]
        return
    for text in typed.get("value", "").split():
        yield _reader(kind)(text)


def _reader(kind: str) -> Callable[[str], Scalar]:
    if kind == "Boolean":
        return _TRUTH.__getitem__
    if kind in ("Real", "Float64", "Float32"):
        return _finite
    if kind == "Integer" or kind.removeprefix("U").startswith("Int"):
        return int
    raise ValueError(kind)


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(text)
    return value
