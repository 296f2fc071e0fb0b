"""Models: shapes for commands, their bundle folders, and how they see the points of a run."""
