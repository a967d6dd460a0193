"""Commands that need no study, and what all commands share."""
