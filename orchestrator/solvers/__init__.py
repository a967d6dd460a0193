"""Solvers of differential equations for model exchange: the contract, and one file a family."""
