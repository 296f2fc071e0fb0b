"""Any log with a mapping file → run: tables, frames, checks, and a proposed mapping.

The checks compare the data with what was declared.
"""
