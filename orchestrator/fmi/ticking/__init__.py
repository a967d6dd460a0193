"""What an instance does with its clocks: what it asks the FMU for and tells it, and when its inputs are set."""
