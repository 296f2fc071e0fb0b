"""Choose what to record next: blocks of commands, and the file that a robot plays."""
