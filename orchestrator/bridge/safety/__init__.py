"""When what a coupling exchanges is not to be trusted: peers that stay away, outputs that rest at safe values."""
