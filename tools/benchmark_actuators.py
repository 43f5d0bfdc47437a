"""Cost of a robot's actuators as a share of its environment step.

  python tools/benchmark_actuators.py --num-envs 4096 --device cuda --output docs/benchmarks

The servos of the task, and the same groups as PD actuators in torch, without and with a random delay. Actions are
random.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from benchmark_step import heading, synchronize, timed
from mjlab_actuators import ActuatorCfg, IdealPdActuatorCfg, NativePositionActuatorCfg
from mjlab_envs import ManagerBasedRlEnv
from stage_timing import time_methods

VARIANTS: dict[str, dict[str, int] | None] = {
  "servos in MuJoCo": None,
  "PD actuators": {},
  "PD actuators, lag of 0 to 3 substeps": {"delay_min_lag": 0, "delay_max_lag": 3},
}


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("task", nargs="?", default="Mjlab-Velocity-Flat-Unitree-G1")
  parser.add_argument("--num-envs", type=int, default=4096)
  parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
  parser.add_argument("--steps", type=int, default=100)
  parser.add_argument("--repeats", type=int, default=5)
  parser.add_argument("--output", type=Path, help="folder to write the table to")
  args = parser.parse_args()
  rows = []
  for name, delay in VARIANTS.items():
    rows.append({"actuators": name, **measure(args, delay)})
    print(json.dumps(rows[-1]), flush=True)
  if args.output:
    write(args, rows)


def in_torch(servo: ActuatorCfg, delay: dict[str, int]) -> ActuatorCfg:
  """Return the PD actuator that computes in torch what a servo of the task does."""
  assert isinstance(servo, NativePositionActuatorCfg)
  return IdealPdActuatorCfg(
    target_names_expr=servo.target_names_expr,
    stiffness=servo.stiffness,
    damping=servo.damping,
    effort_limit=servo.effort_limit,
    armature=servo.armature,
    **delay,  # pyright: ignore[reportArgumentType]  # ty: ignore[invalid-argument-type]
  )


def measure(args: argparse.Namespace, delay: dict[str, int] | None) -> dict[str, Any]:
  """Step time, and that of `Entity.write_ctrl` in all substeps of a step."""
  from mjlab.registry import load_task

  cfg = load_task(args.task).env
  cfg.scene.num_envs, cfg.seed = args.num_envs, 1
  robot = cfg.scene.entities["robot"]
  servos = robot.articulation.actuators
  if delay is not None:
    actuators = tuple(in_torch(servo, delay) for servo in servos)
    cfg.scene.entities["robot"] = replace(robot, articulation=replace(robot.articulation, actuators=actuators))
  env = ManagerBasedRlEnv(cfg, args.device)
  env.reset()
  action = torch.zeros(args.num_envs, env.action_manager.total_action_dim, device=env.device)

  def step() -> None:
    env.step(action.normal_())

  for _ in range(20):
    step()
  synchronize(env.device)
  total = 1e3 * timed(step, args.steps, args.repeats, env.device)
  spent = time_methods(env, env.scene["robot"], {"write_ctrl": "actuators"}, step, args.steps)["actuators"]
  row = {
    "groups": len(servos),
    "worlds": args.num_envs,
    "engine": env.sim.engine,
    "torch_threads": torch.get_num_threads(),
    "step_ms": round(total, 3),
    "actuators_ms": round(spent, 3),
    "share": f"{spent / total:.1%}",
  }
  env.close()
  return row


def write(args: argparse.Namespace, rows: list[dict[str, Any]]) -> None:
  """Return the rows as a Markdown table."""
  args.output.mkdir(parents=True, exist_ok=True)
  lines = ["| " + " | ".join(rows[0]) + " |", "|" + " --- |" * len(rows[0])]
  lines += ["| " + " | ".join(map(str, row.values())) + " |" for row in rows]
  path = args.output / f"actuators_{args.task}_{args.device.split(':')[0]}.md"
  title = f"Cost of actuators: {args.task}"
  path.write_text(heading(title, args.device) + "\n\n" + "\n".join(lines) + "\n")
  print(f"wrote {path}")


if __name__ == "__main__":
  main()
