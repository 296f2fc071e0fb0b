"""The lab: a page that shows where a model fails, and adds what is missing step by step."""
