"""The recordings of a study, as a campaign."""
