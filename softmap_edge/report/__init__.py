"""Comparison and diagnosis as text, pictures and HTML."""
