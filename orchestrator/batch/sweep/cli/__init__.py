"""The command of this room, which the command line takes up."""
