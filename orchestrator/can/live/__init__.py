"""A live bus: opened, received, recorded and replayed."""
