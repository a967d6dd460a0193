"""The functions of an FMU's library: one face over versions 2.0 and 3.0, co-simulation and model exchange."""
