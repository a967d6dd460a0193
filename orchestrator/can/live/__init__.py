"""A live bus: opened, kept, received and recorded."""
