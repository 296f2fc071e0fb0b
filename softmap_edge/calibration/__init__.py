"""Servo ticks → commands of a model, each parameter with its uncertainty, checked on frames held
out.
"""
