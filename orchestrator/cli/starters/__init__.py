"""Starting files that `servotwin init` writes."""
