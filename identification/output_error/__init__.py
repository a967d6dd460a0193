"""FMUs fitted to recordings by free runs."""
