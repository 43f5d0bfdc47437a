"""Off-policy learning: a replay memory on the device, and soft actor-critic with distributional critics."""
