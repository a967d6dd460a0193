"""Databases of CAN messages: read, written, and what protects the messages."""
