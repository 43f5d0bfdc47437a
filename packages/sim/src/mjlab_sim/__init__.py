"""Many MuJoCo worlds as PyTorch tensors: MuJoCo Warp on a GPU, mujoco.batch on a CPU."""
