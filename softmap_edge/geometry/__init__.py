"""Geometry without a model: rigid fits, sections of a body, centrelines."""
