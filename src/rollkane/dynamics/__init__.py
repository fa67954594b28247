"""Bodies, loads, laws of the contact, and the equations of a rolling body (Kane)."""
