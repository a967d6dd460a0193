"""What of a result other tools run: latencies as components, and a free run as a scenario and an SSP."""
