"""Times that a study tells: lengths in seconds or samples, and how late commands and readings are."""
