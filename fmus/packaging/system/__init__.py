"""A wired system of models as one native FMU."""
