"""What a sweep tells: all its runs together, in figures and as a page."""
