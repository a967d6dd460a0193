"""Runs in real time whose values are changed while they go on: who may ask for changes, and when they are made."""
