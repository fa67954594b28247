"""From a scene and a start to a trajectory, or to an ensemble of them."""
