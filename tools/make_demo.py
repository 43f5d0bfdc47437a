"""Maker of the policies that `demo` shows: `uv run python tools/make_demo.py CHECKPOINT [--task lift]`.

Takes the actor out of a checkpoint, made on a GPU with `uv run train Mjlab-Velocity-Flat-Unitree-Go1
--agent.max-iterations 460`, or with `uv run train Mjlab-Lift-Cube-Yam` for 1332 iterations. Measures it without noise
and pushes: 64 worlds for 20 s, in which no robot may fall, or one goal in each of 64, of which 80 % must be reached and
held. It is kept only if it does, with a manifest of the environment it was measured in. To be run again whenever
observations, actions or configuration classes of its task change; what is kept may itself be given.
"""

import argparse
from datetime import datetime
from pathlib import Path

import torch
from mjlab import load_task
from mjlab_envs import ManagerBasedRlEnv
from mjlab_manipulation import LiftEvaluation
from mjlab_rl import CheckpointPolicy, RunManifest
from mjlab_rl.runs.checkpoint import read_checkpoint, write_checkpoint
from mjlab_rl.runs.manifest import package_versions, write_manifest
from mjlab_velocity.mdp import UniformVelocityCommandCfg, VelocityRanges

PACKAGE = Path(__file__).parents[1] / "packages" / "mjlab" / "src" / "mjlab"
DEMOS = {
  "walk": ("Mjlab-Velocity-Flat-Unitree-Go1", PACKAGE / "demo_policy"),
  "lift": ("Mjlab-Lift-Cube-Yam", PACKAGE / "demo_policy_lift"),
}
WORLDS, SECONDS = 64, 20.0
# A short training has seen the first stage of commands only, and falls now and then at its corners.
RANGES = VelocityRanges(lin_vel_x=(-0.5, 1.0), lin_vel_y=(-0.4, 0.4), ang_vel_z=(-0.5, 0.5))
# Walking: no robot falls or misses the command by more than this on average [m/s].
MOST_ERROR = 0.2
LEAST_SUCCESS = 0.8


def walk(env: ManagerBasedRlEnv, policy: CheckpointPolicy) -> tuple[int, float, float]:
  """Falls, and mean error of the velocity of all worlds and of the worst one [m/s]."""
  falls, errors = 0, []
  with torch.no_grad():
    for _ in range(round(SECONDS / env.step_dt)):
      _, _, terminated, _, _ = env.step(policy(env.get_observations()))
      falls += int(terminated.sum())
      velocity = env.scene["robot"].data.root_link_lin_vel_b[:, :2]
      errors.append((env.command_manager.get_command("twist")[:, :2] - velocity).norm(dim=1))
  error = torch.stack(errors[round(1.0 / env.step_dt) :]).mean(dim=0)
  return falls, float(error.mean()), float(error.max())


def is_walking(env: ManagerBasedRlEnv, policy: CheckpointPolicy) -> bool:
  """Whether it walks."""
  falls, mean, worst = walk(env, policy)
  print(f"{WORLDS} worlds, {SECONDS:g} s: {falls} falls, velocity error {mean:.3f} m/s, worst world {worst:.3f} m/s")
  return not falls and worst <= MOST_ERROR


def is_lifting(env: ManagerBasedRlEnv, policy: CheckpointPolicy) -> bool:
  """Whether it lifts."""
  rate = LiftEvaluation(episodes=WORLDS).run(env, policy).groups["all"]["success_rate"]
  print(f"{WORLDS} worlds, a goal in each: {rate.mean:.3f} held ({rate.low:.3f} .. {rate.high:.3f})")
  return rate.mean >= LEAST_SUCCESS


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("checkpoint", type=Path)
  parser.add_argument("--task", choices=list(DEMOS), default="walk")
  args = parser.parse_args()
  name, folder = DEMOS[args.task]
  state = read_checkpoint(args.checkpoint)
  task = load_task(name)
  cfg = task.play(task.env) if task.play is not None else task.env
  twist = cfg.commands.get("twist")
  if isinstance(twist, UniformVelocityCommandCfg):
    twist.ranges = RANGES
  cfg.scene.num_envs, cfg.seed = WORLDS, 0
  # In rsl-rl's form, which counts iterations from 0.
  iterations = state["iter"] + (0 if state.get("mjlab") else 1)
  actor = {"actor_state_dict": state["actor_state_dict"], "iter": iterations - 1, "infos": None}
  folder.mkdir(exist_ok=True)
  # Beside what is there, which may be what was given.
  candidate = folder / "candidate.pt"
  write_checkpoint(candidate, actor)
  try:
    with ManagerBasedRlEnv(cfg, device="cpu") as env:
      policy = CheckpointPolicy(env, task.agent, task.runner)
      policy.load(candidate)
      is_good = (is_walking if args.task == "walk" else is_lifting)(env, policy)
    if not is_good:
      raise SystemExit("it is not good enough; nothing was kept")
    for old in folder.glob("model_*.pt"):
      old.unlink()
    candidate.rename(folder / f"model_{iterations}.pt")
  finally:
    candidate.unlink(missing_ok=True)
  cfg.seed = None
  manifest = RunManifest(
    task=name,
    env=cfg,
    agent=task.agent,
    runner=task.runner,
    make_env=task.make_env,
    created=datetime.now().astimezone().isoformat(timespec="seconds"),
    command=["tools/make_demo.py", args.checkpoint.name],
    versions=package_versions(),
  )
  write_manifest(folder, manifest)
  print(f"kept in {folder}")


if __name__ == "__main__":
  main()
