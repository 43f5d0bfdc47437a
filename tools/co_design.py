"""Designs of a quadruped under one trained policy: speed against motor torque, as a Pareto picture.

  uv run python tools/co_design.py docs/pictures/co_design.png

Every world has a Go1 of its own: lengths of thigh and shank, density of the legs, and gear ratio of the motors, as
factors. All walk on one command. A gear multiplies torque limits, and rotor inertia by its square.
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
from mjlab import load_task
from mjlab_envs import ManagerBasedRlEnv
from mjlab_rl import CheckpointPolicy
from scipy.stats import qmc

TASK, DEMO = "Mjlab-Velocity-Flat-Unitree-Go1", Path("packages/mjlab/src/mjlab/demo_policy/model_460.pt")
RANGES = {"thigh": (0.85, 1.2), "calf": (0.85, 1.2), "density": (0.5, 2.0), "gear": (0.6, 1.6)}
COMMAND, SETTLE, STEPS = 1.0, 100, 300  # [m/s], policy steps
HANG = 0.16  # height that each link gives the trunk [m]


def build(env: ManagerBasedRlEnv, design: dict[str, torch.Tensor]) -> None:
  """Give every world its design."""
  sim, model = env.sim, env.sim.mj_model
  owners = {"body_pos": model.body_parentid, "geom_pos": model.geom_bodyid, "site_pos": model.site_bodyid}
  fields = (*owners, "body_ipos", "body_mass", "body_inertia", "dof_armature", "actuator_forcerange")
  sim.expand_model_fields(fields)
  new = {name: getattr(sim.model, name) for name in fields}
  for body in range(model.nbody):
    if (part := model.body(body).name.rpartition("_")[2]) in design:
      length, mass = design[part], design[part] * design["density"]
      new["body_ipos"][:, body, 2] *= length
      new["body_mass"][:, body] *= mass
      new["body_inertia"][:, body] *= (mass * length.square())[:, None]
      for name, owner in owners.items():
        new[name][:, np.flatnonzero(owner == body), 2] *= length[:, None]
  new["dof_armature"] *= design["gear"].square()[:, None]
  new["actuator_forcerange"] *= design["gear"][:, None, None]
  sim.recompute_constants()


def walk(env: ManagerBasedRlEnv, policy: CheckpointPolicy, design: dict[str, torch.Tensor]) -> list[np.ndarray]:
  """Return forward speed [m/s] and RMS torque of a motor [N m] after settling, and which worlds stayed up."""
  env.reset()
  env.sim.data.qpos[:, 2] += HANG * (design["thigh"] + design["calf"] - 2.0)
  speed, square = torch.zeros(2, env.num_envs)
  stayed = torch.ones(env.num_envs, dtype=torch.bool)
  with torch.no_grad():
    for step in range(STEPS):
      _, _, terminated, _, _ = env.step(policy(env.get_observations()))
      stayed &= ~terminated
      if step >= SETTLE:
        data = env.scene["robot"].data
        speed += data.root_link_lin_vel_b[:, 0] / (STEPS - SETTLE)
        square += (data.qfrc_actuator / design["gear"][:, None]).square().mean(1) / (STEPS - SETTLE)
  return [values.numpy() for values in (speed, square.sqrt(), stayed)]


def main() -> None:
  """Draw designs, let them walk, and plot those that no other one beats in speed and torque."""
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("output", type=Path)
  parser.add_argument("--designs", type=int, default=1024)
  args = parser.parse_args()
  task = load_task(TASK)
  cfg = task.play(task.env) if task.play is not None else task.env
  cfg.scene.num_envs, cfg.seed = args.designs, 0
  twist = cfg.commands["twist"]
  twist.standing_fraction, ranges = 0.0, twist.ranges  # by default a tenth of the worlds stands
  ranges.lin_vel_x, ranges.lin_vel_y, ranges.ang_vel_z = (COMMAND, COMMAND), (0.0, 0.0), (0.0, 0.0)
  points = qmc.scale(qmc.Sobol(len(RANGES), rng=0).random(args.designs), *zip(*RANGES.values(), strict=True))
  points[0] = 1.0  # the robot as it is
  design = dict(zip(RANGES, torch.as_tensor(points, dtype=torch.float32).T, strict=True))
  with ManagerBasedRlEnv(cfg, "cpu") as env:
    policy = CheckpointPolicy(env, task.agent, task.runner)
    policy.load(DEMO)
    build(env, design)
    speed, torque, up = walk(env, policy, design)
  front = [i for i in np.flatnonzero(up) if not ((speed > speed[i]) & (torque < torque[i]) & up).any()]
  front.sort(key=lambda i: speed[i])
  print(f"{args.designs - up.sum()} of {args.designs} fell; as it is: {speed[0]:.2f} m/s, {torque[0]:.2f} N m")
  for i in front:
    print(f"{speed[i]:.2f} m/s {torque[i]:.2f} N m:", *(f"{name} {points[i, k]:.2f}" for k, name in enumerate(RANGES)))
  _, axes = plt.subplots(figsize=(6.5, 4.5), layout="constrained")
  shown = axes.scatter(torque[up], speed[up], c=points[up, 3], s=8)
  axes.plot(torque[front], speed[front], "k.-", label="not beaten")
  axes.plot(torque[0], speed[0], "r*", markersize=14, label="Go1")
  axes.set(xlabel="RMS motor torque [N m]", ylabel=f"forward speed, commanded {COMMAND:g} [m/s]")
  plt.colorbar(shown, label="gear ratio [of the Go1's]")
  axes.legend()
  plt.savefig(args.output, dpi=100)


if __name__ == "__main__":
  main()
