"""Servo ticks → a model's commands, each parameter with its uncertainty, checked held out."""
