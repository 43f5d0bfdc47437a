"""Makes the policy that `demo` shows: `uv run python tools/make_demo.py CHECKPOINT`.

Takes the actor out of a checkpoint of Mjlab-Velocity-Flat-Unitree-Go1, made on a GPU with `uv run train
Mjlab-Velocity-Flat-Unitree-Go1 --agent.max-iterations 460`. Measures it in 64 worlds for 20 s, without noise and
pushes, and keeps it only if it walks, with a manifest of the environment it was measured in. To be run again whenever
the task's observations, actions or configuration classes change; `demo_policy/model_460.pt` itself may be given.
"""

import argparse
from datetime import datetime
from pathlib import Path

import torch
from mjlab import load_task
from mjlab_envs import ManagerBasedRlEnv
from mjlab_rl import CheckpointPolicy, RunManifest
from mjlab_rl.checkpoint import FORMAT, read_checkpoint, write_checkpoint
from mjlab_rl.manifest import package_versions, write_manifest
from mjlab_velocity.mdp import UniformVelocityCommandCfg, VelocityRanges

TASK = "Mjlab-Velocity-Flat-Unitree-Go1"
FOLDER = Path(__file__).parents[1] / "packages" / "mjlab" / "src" / "mjlab" / "demo_policy"
WORLDS, SECONDS = 64, 20.0
# A short training has seen the first stage of commands only, and falls now and then at its corners.
RANGES = VelocityRanges(lin_vel_x=(-0.5, 1.0), lin_vel_y=(-0.4, 0.4), ang_vel_z=(-0.5, 0.5))
# Walking: nobody falls, and nobody misses the command by more than this on average [m/s].
MOST_ERROR = 0.2


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


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("checkpoint", type=Path)
  args = parser.parse_args()
  state = read_checkpoint(args.checkpoint)
  task = load_task(TASK)
  cfg = task.play(task.env) if task.play is not None else task.env
  twist = cfg.commands["twist"]
  assert isinstance(twist, UniformVelocityCommandCfg)
  twist.ranges = RANGES
  cfg.scene.num_envs, cfg.seed = WORLDS, 0
  actor = {
    "actor_state_dict": state["actor_state_dict"],
    "iter": state["iter"],
    "infos": None,
    "mjlab": {"format": FORMAT},
  }
  FOLDER.mkdir(exist_ok=True)
  # Beside what is there, which may be what was given.
  candidate = FOLDER / "candidate.pt"
  write_checkpoint(candidate, actor)
  try:
    with ManagerBasedRlEnv(cfg, device="cpu") as env:
      policy = CheckpointPolicy(env, task.agent, task.runner)
      policy.load(candidate)
      falls, mean, worst = walk(env, policy)
    print(f"{WORLDS} worlds, {SECONDS:g} s: {falls} falls, velocity error {mean:.3f} m/s, worst world {worst:.3f} m/s")
    if falls or worst > MOST_ERROR:
      raise SystemExit("it does not walk well enough; nothing was kept")
    for old in FOLDER.glob("model_*.pt"):
      old.unlink()
    candidate.rename(FOLDER / f"model_{state['iter']}.pt")
  finally:
    candidate.unlink(missing_ok=True)
  cfg.seed = None
  manifest = RunManifest(
    task=TASK,
    env=cfg,
    agent=task.agent,
    runner=task.runner,
    make_env=task.make_env,
    created=datetime.now().astimezone().isoformat(timespec="seconds"),
    command=["tools/make_demo.py", args.checkpoint.name],
    versions=package_versions(),
  )
  write_manifest(FOLDER, manifest)
  print(f"kept in {FOLDER}")


if __name__ == "__main__":
  main()
