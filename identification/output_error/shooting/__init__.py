"""Multiple shooting: windows run in segments that are joined as the search goes on."""
