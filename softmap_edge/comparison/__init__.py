"""The error of a model: how large it is, where and when, after a run and during one."""
