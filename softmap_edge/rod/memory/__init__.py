"""Identify the memory of a robot in its reference runs: first its family, then its law."""
