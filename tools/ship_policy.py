"""Puts a trained policy where `demo` finds it: `uv run python tools/ship_policy.py RUN|CHECKPOINT NAME`.

NAME is one of the table in packages/mjlab/src/mjlab/demos.py, and the run is of its task. The policy is exported as a
bundle, verified, and played in its task without pushes. If it passes, it is kept in the folder NAME of
packages/mjlab/src/mjlab/demo_policies. Statistics of `evaluate` beside the run become part of the bundle. This takes
a few minutes on a CPU.
"""

import argparse
import shutil
import tempfile
from pathlib import Path
from typing import Any

import torch
from mjlab import cli, load_task
from mjlab.demos import TASKS
from mjlab.environments import standard_env
from mjlab_deploy import open_bundle
from mjlab_deploy.verification import verify
from mjlab_manipulation import LiftEvaluation
from mjlab_rl import BundlePolicy, find_checkpoint, load_run

FOLDER = Path(__file__).parents[1] / "packages" / "mjlab" / "src" / "mjlab" / "demo_policies"
SECONDS = 10.0


def is_good(folder: Path, name: str, args: argparse.Namespace) -> bool:
  """Play the policy in its task without pushes, print how it does, and return True if it may ship."""
  parts, worlds = load_task(TASKS[name]), args.worlds
  cfg: Any = parts.play(parts.env) if parts.play is not None else parts.env
  cfg.scene.num_envs, cfg.seed = worlds, 0
  with standard_env(cfg, device="cpu") as env:
    policy = BundlePolicy(folder, env)
    if name.startswith("lift"):
      rate = LiftEvaluation(episodes=worlds).run(env, policy).groups["all"]["success_rate"].mean
      print(f"{rate:.0%} of {worlds} goals are reached and held (at least {args.least_success:.0%})")
      return rate >= args.least_success
    fallen, errors = torch.zeros(worlds, dtype=torch.bool), []
    for step in range(round(SECONDS / env.step_dt)):
      _, _, terminated, truncated, _ = env.step(policy(env.get_observations()))
      policy.reset(terminated | truncated)
      fallen |= terminated
      if "twist" in env.command_manager.active_terms and step * env.step_dt > 1.0:
        velocity = env.scene["robot"].data.root_link_lin_vel_b[:, :2]
        errors.append((env.command_manager.get_command("twist")[:, :2] - velocity).norm(dim=1))
  falls = int(fallen.sum())
  print(f"{falls} of {worlds} episodes of {SECONDS:g} s end in a fall (at most {args.most_falls:.0%})")
  error = float(torch.stack(errors).mean()) if errors else 0.0
  print(
    f"mean error of the velocity is {error:.2f} m/s (at most {args.most_error:g})" if errors else "no velocity command"
  )
  return falls <= args.most_falls * worlds and error <= args.most_error


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("run", help="run directory, or a checkpoint")
  parser.add_argument("name", choices=list(TASKS))
  parser.add_argument("--steps", type=int, default=200, help="steps of the record in the bundle")
  parser.add_argument("--worlds", type=int, default=64, help=f"episodes of {SECONDS:g} s to play")
  parser.add_argument("--most-falls", type=float, default=0.02, help="largest share of episodes that end in a fall")
  parser.add_argument("--most-error", type=float, default=0.3, help="largest mean error of the velocity [m/s]")
  parser.add_argument("--least-success", type=float, default=0.8, help="smallest share of cubes at their goal")
  args = parser.parse_args()
  checkpoint = find_checkpoint(args.run, log_root=Path("logs"), experiment="")
  if (trained := load_run(checkpoint).task) != TASKS[args.name]:
    parser.error(f"{args.run} is of {trained}; {args.name} ships {TASKS[args.name]}")
  with tempfile.TemporaryDirectory() as temporary:
    made = Path(temporary) / "bundle"
    if cli.main(["export", str(checkpoint), "--output", str(made), "--steps", str(args.steps)]):
      raise SystemExit("it cannot be exported; nothing was kept")
    with open_bundle(made) as bundle:
      report = verify(bundle)
    print("\n".join((*report.notes, *report.failures)))
    if not report.passed:
      raise SystemExit("it is not verified; nothing was kept")
    if not is_good(made, args.name, args):
      raise SystemExit("it is not good enough; nothing was kept")
    shutil.rmtree(FOLDER / args.name, ignore_errors=True)
    shutil.copytree(made, FOLDER / args.name)
  sizes = {folder.name: sum(file.stat().st_size for file in folder.iterdir()) for folder in FOLDER.iterdir()}
  print(f"kept in {FOLDER / args.name}: {sizes[args.name] / 1e6:.1f} MB; all: {sum(sizes.values()) / 1e6:.1f} MB")


if __name__ == "__main__":
  main()
