"""Which kernels a replayed environment step spends its time in (GPU).

python tools/profile_step.py Mjlab-Velocity-Flat-Unitree-Go1 --num-envs 4096
"""

import argparse
import collections
import re

import torch
from benchmark_step import make


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("task")
  parser.add_argument("--num-envs", type=int, default=4096)
  parser.add_argument("--steps", type=int, default=10)
  parser.add_argument("--rows", type=int, default=45)
  args = parser.parse_args()
  env = make(args.task, args.num_envs, "cuda", "auto", capture=True)
  env.reset()
  action = torch.zeros(args.num_envs, env.action_manager.total_action_dim, device=env.device)
  for _ in range(30):
    env.step(action.normal_())
  with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CUDA]) as profile:
    for _ in range(args.steps):
      env.step(action.normal_())
    torch.cuda.synchronize()
  total = collections.Counter()
  count = collections.Counter()
  for event in profile.events() or ():
    name = re.sub(r"<.*", "", event.name)[:70]
    total[name] += event.device_time
    count[name] += 1
  print(f"{sum(total.values()) / args.steps / 1e3:.3f} ms in {sum(count.values()) / args.steps:.0f} kernels a step")
  for name, time in total.most_common(args.rows):
    print(f"{time / args.steps:9.1f} us  {count[name] / args.steps:7.1f} x  {name}")


if __name__ == "__main__":
  main()
