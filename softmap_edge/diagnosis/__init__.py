"""Name the effect that a model lacks: its family first, then its law."""
