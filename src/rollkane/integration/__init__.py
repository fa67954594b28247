"""Runge-Kutta steps, their derivatives, and the backends: C and diffrax."""
