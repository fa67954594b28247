"""Runs that change between rolling, slipping and flight."""
