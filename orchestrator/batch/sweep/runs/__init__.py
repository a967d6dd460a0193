"""Who runs the points of a sweep, and the folder that their rows go to."""
