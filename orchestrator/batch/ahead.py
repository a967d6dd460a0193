"""What nearly every file of a suite needs, loaded once by the server that its processes are forked from: they would
each load it anew, which takes as long as a short scenario."""

import email.parser  # noqa: F401 (of the versions that a manifest tells)
import importlib.resources.readers  # noqa: F401

import fmpy.validation  # noqa: F401
import lxml.etree  # noqa: F401

import orchestrator.batch.scenario_judge
import orchestrator.formats.parquet  # noqa: F401
from fmus.packaging import targets
from orchestrator.results import versions

targets.read_ahead()
versions()
