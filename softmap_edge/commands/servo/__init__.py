"""The actions of `softmap servo`: find, set up, commission, move, check and emulate servos.

`commands.py` holds the table of actions.
"""
