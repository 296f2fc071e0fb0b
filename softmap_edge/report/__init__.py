"""Comparison and diagnosis as text, figures and HTML."""
