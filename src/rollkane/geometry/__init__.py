"""Small matrices, rotations, surfaces and their fundamental forms."""
