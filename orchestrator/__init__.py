"""Running FMUs together: traces, wiring, stepping, scenarios, the command line."""
