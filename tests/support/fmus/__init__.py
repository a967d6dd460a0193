"""Small FMUs for tests, and what opens, steps and moves those that were built."""
