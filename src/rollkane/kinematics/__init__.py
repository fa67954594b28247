"""Motion of the base, contact kinematics, and the coordinates of a state."""
