"""Training with rsl-rl: vec-env adapter, runner, checkpoints, run manifests."""
