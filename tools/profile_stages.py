"""Time of each stage of an environment step, and the share of physics.

  python tools/profile_stages.py Mjlab-Velocity-Flat-Unitree-Go1 --num-envs 4096 --device cuda --output docs/benchmarks

On a GPU every stage is a graph of its own here, so the sum exceeds the time of a whole step, which is one graph.
Physics is every call of the engine: steps, forward passes after resets and pushes, and resets.
"""

import argparse
from pathlib import Path

import torch
from benchmark_step import heading, make, timed
from stage_timing import ENGINE_CALLS, time_methods

STAGES = ("act", "simulate", "terminate", "reward", "reset", "command", "event", "observe")


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("task")
  parser.add_argument("--num-envs", type=int, default=4096)
  parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
  parser.add_argument("--steps", type=int, default=100)
  parser.add_argument("--output", type=Path)
  args = parser.parse_args()
  env = make(args.task, args.num_envs, args.device, "auto", capture=True)
  env.reset()
  action = torch.zeros(args.num_envs, env.action_manager.total_action_dim, device=env.device)

  def step() -> None:
    env.step(action.normal_())

  for _ in range(20):
    step()
  whole = 1e3 * timed(step, 100, 3, env.device)
  stages = time_methods(env, env, {f"_{name}": name for name in STAGES}, step, args.steps)
  engine = time_methods(env, env.sim._engine, ENGINE_CALLS, step, args.steps)
  lines = [heading(f"Stages of a step: {args.task}", args.device), ""]
  lines += [f"{args.num_envs} worlds, random actions; whole step {whole:.2f} ms.", ""]
  lines += ["| stage | ms | share |", "| --- | --- | --- |"]
  lines += [f"| {name} | {stages[name]:.3f} | {stages[name] / sum(stages.values()):.2f} |" for name in STAGES]
  lines += ["", "| engine call | ms a step |", "| --- | --- |"]
  lines += [f"| {name} | {spent:.3f} |" for name, spent in engine.items()]
  lines += ["", f"Physics is {sum(engine.values()) / whole:.2f} of the step."]
  print("\n".join(lines))
  if args.output:
    args.output.mkdir(parents=True, exist_ok=True)
    path = args.output / f"stages_{args.task}_{env.device.type}.md"
    path.write_text("\n".join(lines) + "\n")
  env.close()


if __name__ == "__main__":
  main()
