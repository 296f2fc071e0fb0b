"""What to record next: blocks of commands, the choice between them, and the file that carries them
to a robot.
"""
