"""From a camera to commands: pictures, the landmarks of a hand, its own frame, and what of it drives the finger."""
