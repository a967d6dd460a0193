"""Models of servo-driven mechanisms, and how they become FMUs."""
