"""MF4 bus logs, read by asammdf in a process of its own."""
