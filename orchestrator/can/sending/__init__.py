"""Frames onto buses: a log as it was recorded, and what passes from one bus to another."""
