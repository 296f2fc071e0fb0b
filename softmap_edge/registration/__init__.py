"""Registration: the template of a finger laid onto point clouds of it."""
