"""FMUs in the terms of the compiled loop, which has their functions and values by their addresses."""
