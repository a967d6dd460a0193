"""What estimation computes with that NumPy lacks."""
