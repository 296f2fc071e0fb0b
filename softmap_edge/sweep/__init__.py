"""Make models of imported sweeps: commands and points from any simulator or recording."""
