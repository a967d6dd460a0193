"""What differs between two runs: signal by signal, against a reference, and drawn."""
