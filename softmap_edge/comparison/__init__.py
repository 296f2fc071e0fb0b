"""How far off a model is, where, and when: after a run and during one."""
