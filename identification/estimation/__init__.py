"""What methods share: least squares, parameters, workers, uncertainty, validation."""
