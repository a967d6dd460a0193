"""Linear models of FMUs and of systems of them about a point: of components, joined, and over a sample period."""
