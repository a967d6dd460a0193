"""Native FMUs: generated C, its runtime, and the compiler."""
