"""Buses, adapters, frames and databases for tests."""
