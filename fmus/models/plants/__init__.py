"""What is driven: motors, pendulums, arms and axes, and linear systems of any size."""

from .. import *  # noqa: F403 - a model file takes the language from where it lies, as a user's own does
