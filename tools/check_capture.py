"""Drift between replayed and eager steps from one state, with the same actions and draws.

  python tools/check_capture.py Mjlab-Velocity-Flat-Unitree-Go1 --num-envs 4096 --device cuda --output docs/benchmarks

The order of contacts on a GPU is not deterministic, so two eager runs differ too. Replay may not differ by more.
"""

import argparse
import time
from pathlib import Path

import torch
from benchmark_step import make


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("task")
  parser.add_argument("--num-envs", type=int, default=4096)
  parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
  parser.add_argument("--engine", default="auto")
  parser.add_argument("--steps", type=int, default=12)
  parser.add_argument(
    "--warm-up", type=int, default=40, help="steps before the common state, so that worlds have ended"
  )
  parser.add_argument("--output", type=Path)
  args = parser.parse_args()

  runs: dict[str, list[tuple[torch.Tensor, ...]]] = {}
  start = generator_state = None
  for name, capture in (("captured", True), ("eager", False), ("eager again", False)):
    env = make(args.task, args.num_envs, args.device, args.engine, capture)
    env.reset()
    actions = torch.Generator(env.device).manual_seed(0)
    shape = (args.num_envs, env.action_manager.total_action_dim)

    def act(generator: torch.Generator = actions, shape: tuple[int, int] = shape) -> torch.Tensor:
      return torch.randn(shape, generator=generator, device=generator.device)

    if start is None or generator_state is None:
      for _ in range(args.warm_up):
        env.step(act())
      start, generator_state = env.state_dict(), actions.get_state()
    else:
      env.load_state_dict(start)
      actions.set_state(generator_state)
    runs[name] = []
    for _ in range(args.steps):
      obs, reward, terminated, truncated, _ = env.step(act())
      actor = obs["actor"]
      assert isinstance(actor, torch.Tensor), "the actor's observations are not one tensor"
      runs[name].append((actor, reward, terminated | truncated))
    env.close()

  lines = [
    "| step | eager/eager observation | captured/eager observation | eager/eager reward | captured/eager reward |"
  ]
  lines += ["| --- | --- | --- | --- | --- |"]
  for k in range(args.steps):
    cells = [str(k + 1)]
    for index in (0, 1):
      for other in ("eager again", "captured"):
        a, b = runs["eager"][k][index], runs[other][k][index]
        cells.append(f"{(a - b).abs().mean().item():.3g} (worst {(a - b).abs().max().item():.2g})")
    lines.append("| " + " | ".join([cells[0], cells[1], cells[2], cells[3], cells[4]]) + " |")
  ended = {name: [int(step[2].sum()) for step in trace] for name, trace in runs.items()}
  text = "\n".join(
    [
      f"# Captured against eager: {args.task}",
      "",
      f"{time.strftime('%Y-%m-%d')}, {args.num_envs} worlds, {args.device}; mean absolute difference and the worst.",
      "",
      *lines,
      "",
      "Worlds that ended in each step: " + "; ".join(f"{name} {counts}" for name, counts in ended.items()) + ".",
    ]
  )
  print(text)
  if args.output:
    args.output.mkdir(parents=True, exist_ok=True)
    (args.output / f"capture_{args.task}_{args.device.split(':')[0]}.md").write_text(text + "\n")


if __name__ == "__main__":
  main()
