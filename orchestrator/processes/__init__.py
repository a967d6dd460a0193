"""The processes that a command is: its ends and last words, others side by side, and the memory they may take."""
