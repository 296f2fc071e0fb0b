"""The control loop in its own process: controller, supervision, recordings."""
