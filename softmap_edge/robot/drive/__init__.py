"""Play commands, follow figures, and store what was commanded and seen."""
