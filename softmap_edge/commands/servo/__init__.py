"""The commands of `softmap servo`: one module for each, but the shortest."""
