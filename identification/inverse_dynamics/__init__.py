"""Inverse dynamics: linear least squares and instrumental variables on filtered motions."""
