"""What to record next: blocks of commands, their choice, and the file that a robot plays."""
