"""How far off a model is, where, and which effect explains it."""
