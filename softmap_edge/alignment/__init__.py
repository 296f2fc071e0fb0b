"""Transform camera or motion-capture frames to the base frame; fit templates to point clouds."""
