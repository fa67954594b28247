"""Symmetries, steady motions, their linear models and stability."""
