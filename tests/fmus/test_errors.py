"""The tree of errors that is drawn is the one that there is."""

from __future__ import annotations

import pickle
import re
from importlib import import_module
from pkgutil import walk_packages

import fmus
import identification
import orchestrator
from fmus import errors
from fmus.errors import FmuError, PartialError, ServotwinError


def drawn() -> dict[str, tuple[str, int | None]]:
    """Error -> its parent in the drawing, and the exit code that it states."""
    tree, above = {}, [("Exception", -1)]
    for line in str(errors.__doc__).splitlines():
        found = re.match(r"([│├└─ ]*)([A-Z]\w+(?:Error|Failed|Ended|Missing|Refused|Discarded))\b", line)
        if found is None:
            continue
        depth = len(found[1]) // 4
        above = [*(entry for entry in above if entry[1] < depth), (found[2], depth)]
        code = re.search(r"exit code (\d)", line)
        tree[found[2]] = (above[-2][0], int(code[1]) if code else None)
    return tree


def all_errors() -> set[type[ServotwinError]]:
    """Every error of the three packages, wherever it is defined."""
    for package in (fmus, orchestrator, identification):
        for module in walk_packages(package.__path__, f"{package.__name__}."):
            if not module.name.startswith("fmus.packaging.python.slave"):
                try:
                    import_module(module.name)
                except ModuleNotFoundError as missing:
                    assert missing.name == "distributed"
    found, new = set(), {ServotwinError}
    while new:
        found |= new
        new = {kind for parent in new for kind in parent.__subclasses__()} - found
    return {kind for kind in found if kind.__module__.split(".")[0] in ("fmus", "orchestrator", "identification")}


def test_the_tree_of_errors_is_drawn_as_it_is() -> None:
    real = {kind.__name__: kind.__mro__[1].__name__ for kind in all_errors()}
    assert {name: parent for name, (parent, _) in drawn().items()} == real


def test_every_error_exits_with_the_code_that_the_drawing_states() -> None:
    tree, real = drawn(), {kind.__name__: kind for kind in all_errors()}
    for name in tree:
        stated, above = tree[name][1], name
        while stated is None and above in tree:
            above = tree[above][0]
            stated = tree[above][1] if above in tree else ServotwinError.exit_code
        assert real[name].exit_code == stated


def test_every_error_comes_back_whole_from_another_process() -> None:
    for kind in all_errors():
        if issubclass(kind, PartialError):
            continue
        error = pickle.loads(pickle.dumps(kind("place", "problem", "fix")))
        assert type(error) is kind and str(error) == "place: problem; fix"


def test_a_failure_with_a_result_comes_back_as_the_failure_alone() -> None:
    for kind in all_errors():
        if issubclass(kind, PartialError):
            error = pickle.loads(pickle.dumps(kind(FmuError("place", "problem", "fix"), object())))
            assert type(error) is FmuError and str(error) == "place: problem; fix"


def test_an_error_is_one_line_whatever_names_from_outside_hold() -> None:
    error = ServotwinError("a\nb", "holds\r\n\n  two\u2028three", "mend\vit").within("out\x85side")
    assert str(error) == "out side: a b: holds two three; mend it"
    assert (error.place, error.problem) == ("out\x85side: a\nb", "holds\r\n\n  two\u2028three")
