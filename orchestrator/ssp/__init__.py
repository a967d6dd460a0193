"""Systems as `.ssp` archives of System Structure and Parameterization 1.0 and 2.0, in and out."""
