"""Values into FMUs: written back into ours, as SSV and SSP beside foreign ones."""
