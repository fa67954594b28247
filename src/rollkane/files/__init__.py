"""Scene files, accelerograms, export, and files that appear whole or not at all."""
