"""The quasi-velocities and Euler-Lagrange equations of the 2004 paper, as a twin."""
