"""What happens on the buses of a coupling, in this process or in one of their own."""
