"""FMUs on a simulated bus: their terminals after FMI-LS-BUS, and what carries operations from one to the others."""
