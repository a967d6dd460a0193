"""CAN: frames, databases, log files, and a live bus coupled to a running co-simulation."""
