"""How a controller's values are found; each procedure is a file with an entry in `table`."""
