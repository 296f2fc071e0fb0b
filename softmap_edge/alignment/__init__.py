"""Camera or motion-capture frame → base frame; templates laid onto point clouds."""
