"""BLF logs: objects in compressed containers, read and written many frames at once."""
