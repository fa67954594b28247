"""Checks of what a user gives, codes of how a run ended, and a user's functions."""
