"""Any log with a mapping file → run: tables, frames, what does not look as declared, and a mapping proposed."""
