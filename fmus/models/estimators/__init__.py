"""What infers what is not measured: disturbances and payloads."""

from .. import *  # noqa: F403 - a model file takes the language from where it lies, as a user's own does
