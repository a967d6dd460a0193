"""From components and connections in a file to a running system."""
