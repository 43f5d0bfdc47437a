#!/bin/bash
#SBATCH --job-name=mjlab
#SBATCH --nodes=2
#SBATCH --ntasks-per-node=4
#SBATCH --gpus-per-node=4
#SBATCH --cpus-per-task=8
#SBATCH --time=04:00:00
#SBATCH --signal=TERM@120
# Run this from the folder of the clone, on a disk that all nodes share: sbatch docs/recipes/slurm.sh
# Before its end the job gets SIGTERM, so that the training saves. To continue, add --resume.
set -euo pipefail
MASTER_ADDR=$(scontrol show hostnames "$SLURM_JOB_NODELIST" | head -n 1)
export MASTER_ADDR
srun uv run train Mjlab-Velocity-Flat-Unitree-G1 --env.scene.num-envs 4096
