"""Starting files of studies that `servotwin init` writes."""
