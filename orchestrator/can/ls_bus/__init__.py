"""CAN between FMUs after the layered standard FMI-LS-BUS: operations, and the bus that carries them."""
