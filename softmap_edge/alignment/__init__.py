"""Camera or mocap frame → base frame, with its uncertainty; poses between points."""
