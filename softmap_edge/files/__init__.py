"""Files of any kind: written completely or not at all, read within limits."""
