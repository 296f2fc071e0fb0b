"""Play commands and follow figures, and keep what was commanded and seen."""
