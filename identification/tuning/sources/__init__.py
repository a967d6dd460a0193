"""Where the linear loops' parts come from: matrices, FMUs and models, linearised where they rest."""
