"""What drives: from a set-point and measurements to a command, and filters of that command."""

from .. import *  # noqa: F403 - a model file takes the language from where it lies, as a user's own does
