"""The figures of commands as a user meets them."""
