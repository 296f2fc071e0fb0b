"""Any log with a mapping file → run: tables, frames, checks of what was declared, and a proposed
mapping.
"""
