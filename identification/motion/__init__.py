"""Recalibration near a motion."""
