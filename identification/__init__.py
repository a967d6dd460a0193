"""From recordings to parameters: calibration of FMUs, linear models, frequency responses.

    from identification import calibrate, design, load_study, tune, validate    # studies, as the commands do them
    from identification import estimate, predict, subspace, frequency_response  # the methods on their own
    from identification import linearise                                        # a wired system as a linear model

`calibrate` fits what a study leaves free and writes the result back into FMUs; `validate` judges a result on other
recordings; `tune` finds the values of a controller, `design` the next experiments. `estimate` fits windows by free runs
and `predict` runs them; `subspace` finds a linear model in records; `frequency_response` compares sines; `linearise`
makes a linear model of a scenario's system about a point of its run. What is named here is loaded when it is used.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from identification.calibrate import calibrate, design, tune
    from identification.linearisation.linearise import linearise
    from identification.output_error.search.estimator import estimate, predict
    from identification.signals.frequency_response import frequency_response
    from identification.study import load_study
    from identification.subspace.subspace import subspace
    from identification.validation import validate

__all__ = [
    "calibrate",
    "design",
    "estimate",
    "frequency_response",
    "linearise",
    "load_study",
    "predict",
    "subspace",
    "tune",
    "validate",
]

_PLACES = {
    "calibrate": "calibrate",
    "design": "calibrate",
    "estimate": "output_error.search.estimator",
    "frequency_response": "signals.frequency_response",
    "linearise": "linearisation.linearise",
    "load_study": "study",
    "predict": "output_error.search.estimator",
    "subspace": "subspace.subspace",
    "tune": "calibrate",
    "validate": "validation",
}


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module 'identification' has no attribute '{name}'")
    return getattr(import_module(f"identification.{_PLACES[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


class _Vocabulary(ModuleType):
    """Keeps its names for functions: to import a module or room of such a name would put that here."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name not in _PLACES:
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Vocabulary
