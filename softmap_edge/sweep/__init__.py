"""Models of sweeps made elsewhere: commands and points from any simulator or recording."""
