"""Contacts and constraint rows that a trained policy needs, and steps that overflowed their buffers.

  python tools/benchmark_contacts.py logs/g1_velocity/RUN --num-envs 4096 --output docs/benchmarks

Plays the policy of a run in its training environment, noise, pushes and resets included; on a terrain of tiles worlds
begin on every row. Counts are read after every environment step, on MuJoCo Warp.
"""

import argparse
from pathlib import Path
from typing import Any

import torch
import warp as wp
from benchmark_step import heading
from mjlab_envs import ManagerBasedRlEnv
from mjlab_rl import CheckpointPolicy, checkpoints, load_run


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("run", type=Path, help="a run's directory, or a checkpoint")
  parser.add_argument("--num-envs", type=int, default=4096)
  parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
  parser.add_argument("--steps", type=int, default=1000)
  parser.add_argument("--output", type=Path, help="folder to write the table to")
  args = parser.parse_args()
  checkpoint = args.run if args.run.is_file() else checkpoints(args.run)[-1]
  manifest = load_run(checkpoint)
  cfg = manifest.env
  cfg.scene.num_envs, cfg.scene.max_init_terrain_level = args.num_envs, None
  cfg.sim.engine, cfg.seed = "warp", 1
  env = ManagerBasedRlEnv(cfg, args.device)
  policy = CheckpointPolicy(env, manifest.agent)
  policy.load(checkpoint)
  engine: Any = env.sim._engine
  d = engine._d
  counts: dict[str, list[torch.Tensor]] = {"contacts": [], "constraint rows": []}
  worlds, length, ended = wp.to_torch(d.contact.worldid), wp.to_torch(d.nacon), 0
  index = torch.arange(len(worlds), device=env.device)
  for _ in range(args.steps):
    with torch.no_grad():
      _, _, terminated, truncated, _ = env.step(policy(env.get_observations()))
    policy.reset(terminated | truncated)
    ended += int((terminated | truncated).sum())
    filled = worlds[index < length].long()
    counts["contacts"].append(torch.bincount(filled, minlength=args.num_envs))
    counts["constraint rows"].append(wp.to_torch(d.nefc).clone())
  lines = [
    heading(f"Contacts of a policy that walks: {manifest.task}", args.device),
    "",
    f"{checkpoint.parent.name}, {checkpoint.stem.removeprefix('model_')} iterations, {args.num_envs} worlds, "
    f"{args.steps} steps, {ended} episodes ended.",
    "",
    "| | mean of a world | 99 of 100 | most in a world | most on average over worlds | buffer |",
    "|---|---|---|---|---|---|",
  ]
  buffers = {"contacts": f"{d.naconmax // args.num_envs} on average", "constraint rows": f"{d.njmax} in each"}
  for name, samples in counts.items():
    count = torch.stack(samples).float()
    # One world in a hundred, in one step in a hundred: quantile() takes no more than 16 million numbers.
    high = count.flatten().kthvalue(round(0.99 * count.numel())).values
    lines.append(
      f"| {name} | {count.mean():.1f} | {high:.0f} | {count.max():.0f} | {count.mean(1).max():.1f} | {buffers[name]} |"
    )
  overflow = env.sim.overflow_report()
  lines += ["", "Nothing overflowed." if not overflow else " ".join(overflow)]
  print("\n".join(lines))
  env.close()
  if args.output:
    args.output.mkdir(parents=True, exist_ok=True)
    (args.output / f"contacts_{manifest.task}.md").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
  main()
