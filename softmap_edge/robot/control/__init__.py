"""The control loop in a process of its own: its controller, its supervision, its recordings."""
