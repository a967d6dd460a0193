"""One running FMU: FMI 2 or 3, co-simulation or model exchange, here or in a process of its own."""
