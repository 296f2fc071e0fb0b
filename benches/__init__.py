"""Compare speed with peers in one run: `make bench`."""
