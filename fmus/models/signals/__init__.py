"""What goes in and what is seen: excitation, bounds of an experiment, measuring channels."""

from .. import *  # noqa: F403 - a model file takes the language from where it lies, as a user's own does
