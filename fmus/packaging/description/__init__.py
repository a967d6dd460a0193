"""What importers read: modelDescription.xml and the pages beside it."""
