"""Pacing against the clock, deadlines and how late they were met; nothing of CAN."""
