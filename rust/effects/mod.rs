//! Effects: each declared once, in a file of its own; this list is the registry.
