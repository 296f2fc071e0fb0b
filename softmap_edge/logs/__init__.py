"""What goes into `softmap import`: one reader for each format, all giving named columns (`columns.py`)."""
