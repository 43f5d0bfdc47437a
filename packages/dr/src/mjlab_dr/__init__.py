"""Domain randomisation of MuJoCo models and batched tensors."""
