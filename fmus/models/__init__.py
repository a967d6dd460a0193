"""The library, one model a file, and the language that model files are written in.

A model file begins with `from . import Model, State, input_, ops, output, parameter`. Until the next release
`from .model import Model` is understood, too. This file travels inside every Python FMU.
"""

import sys

from ..modelling import control, feedback, friction, model, ops
from ..modelling.model import Delay, Model, Requirement, State, Table, array, input_, output, parameter
from ..modelling.ports import port

__all__ = [
    "Delay",
    "Model",
    "Requirement",
    "State",
    "Table",
    "array",
    "control",
    "feedback",
    "friction",
    "input_",
    "ops",
    "output",
    "parameter",
    "port",
]

sys.modules[f"{__name__}.model"] = model
