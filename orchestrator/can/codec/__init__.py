"""Signals to frames and back."""
