"""Trained policy for `demo`, exported and verified: `uv run python tools/ship_policy.py RUN|CHECKPOINT NAME`.

NAME is one of the table in packages/mjlab/src/mjlab/demos.py, and the run is of its task. The policy is exported as a
bundle, verified, and evaluated in its task, walking robots with pushes up to 1 m/s. If it passes, it is kept in the
folder NAME of packages/mjlab/src/mjlab/demo_policies. Statistics of `evaluate` beside the run become part of the
bundle. This takes a few minutes on a CPU.
"""

import argparse
import shutil
import tempfile
from pathlib import Path
from typing import Any

from mjlab import cli, load_task
from mjlab.demos import TASKS
from mjlab.environments import standard_env
from mjlab_deploy import open_bundle
from mjlab_deploy.simulation.verification import verify
from mjlab_rl import BundlePolicy, find_checkpoint, load_run

FOLDER = Path(__file__).parents[1] / "packages" / "mjlab" / "src" / "mjlab" / "demo_policies"


def is_good(folder: Path, name: str, args: argparse.Namespace) -> bool:
  """Evaluate the policy in its task, print how it does, and return True if it may ship."""
  task = load_task(TASKS[name])
  evaluator: Any = task.evaluator
  cfg: Any = evaluator.configure(task.env)
  with standard_env(cfg, device="cpu") as env:
    found = evaluator.run(env, BundlePolicy(folder, env)).groups["all"]
  results = {metric: interval.mean for metric, interval in found.items()}
  print(", ".join(f"{metric} {value:.3g}" for metric, value in results.items()))
  if "fall_rate" in results:
    return results["fall_rate"] <= args.most_falls and results["lin_vel_rmse"] <= args.most_error
  return results["success_rate"] >= args.least_success


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("run", help="run directory, or a checkpoint")
  parser.add_argument("name", choices=list(TASKS))
  parser.add_argument("--steps", type=int, default=200, help="steps of the record in the bundle")
  parser.add_argument("--most-falls", type=float, default=0.02, help="largest share of episodes that end in a fall")
  parser.add_argument("--most-error", type=float, default=0.3, help="largest mean RMS error of the velocity [m/s]")
  parser.add_argument("--least-success", type=float, default=0.8, help="smallest share of successful episodes")
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
