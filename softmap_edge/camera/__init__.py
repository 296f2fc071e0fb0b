"""What cameras see of a robot: frames of points, on the host's clock, from this machine or another."""
