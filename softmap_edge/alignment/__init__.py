"""Camera or mocap frame → base frame, servo ticks → commands, each with its uncertainty; poses between points."""
