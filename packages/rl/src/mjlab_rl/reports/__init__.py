"""Console, logs and statistics of a training."""
