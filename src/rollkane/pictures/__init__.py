"""Plots, meshes, the viewer, and the summary of a run."""
