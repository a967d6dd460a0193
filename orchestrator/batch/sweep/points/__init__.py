"""What varies over the points of a sweep, and how the points are chosen."""
