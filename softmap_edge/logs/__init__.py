"""Convert logs to runs by a mapping file: tables, frames, checks, and a proposed mapping.

The checks compare the data with the mapping's declarations.
"""
