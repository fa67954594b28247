"""Find the parameters of a scene from records, and how well they are known."""
