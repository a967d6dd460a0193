"""The report of a tuning: `page` puts it together, each other file draws one kind of figure."""
