"""Free runs of a system over the windows of a study, in whatever process."""
