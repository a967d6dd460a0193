"""Programs of others that tests read and run things in."""
