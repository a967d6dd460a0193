"""Python FMUs: the model file as it is, run by pythonfmu."""
