"""A running scenario coupled to a CAN bus."""
