"""Preparation of signals, and their frequency response."""
