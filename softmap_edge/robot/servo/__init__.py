"""The robot's servos: the rig they belong to, what they are allowed, and the loop that drives them."""
