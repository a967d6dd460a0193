"""Files of named arrays: MATLAB's, HDF5, NumPy's, and those of measured channels."""
