"""Models: shapes for commands, their bundle folders, and their view of the points of a run."""
