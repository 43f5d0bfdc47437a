"""Cost of each randomisation event, and the step rate with full randomisation.

  python tools/benchmark_randomization.py Mjlab-Velocity-Flat-Unitree-G1 --num-envs 4096 --output docs/benchmarks

An event is timed by itself: drawing and writing for all worlds, the same with the derived quantities, and that with
one world in a hundred in the mask; on a GPU all are recorded and replayed, as inside a step. Step rates are of the
task without any randomisation, and with all of it drawn at every reset, taken by turns in one process; random
actions throughout, so that worlds keep ending.
"""

import argparse
import statistics
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from benchmark_step import heading, synchronize, timed
from mjlab_dr import (
  FieldRandomizer,
  RandomizeField,
  body_com_offset,
  body_mass,
  geom_friction,
  pseudo_inertia,
  randomize_field,
)

EVENTS: dict[str, FieldRandomizer] = {
  "friction of all geoms": geom_friction(".*", (0.3, 1.2)),
  "mass of all bodies": body_mass(".*", (0.8, 1.2), operation="scale"),
  "centre of mass of all bodies": body_com_offset(".*", (-0.01, 0.01)),
  "pseudo-inertia of all bodies": pseudo_inertia(".*", scale=0.1, t=(-0.01, 0.01)),
  "armature": randomize_field("dof_armature", ".*", (0.8, 1.2), operation="scale"),
  "damping": randomize_field("dof_damping", ".*", (0.0, 0.1), operation="add"),
  "friction loss": randomize_field("dof_frictionloss", ".*", (0.0, 0.1), operation="add"),
  "gains": randomize_field("actuator_gainprm", ".*", {"0": (0.9, 1.1)}, operation="scale"),
  "feedback gains": randomize_field("actuator_biasprm", ".*", {"1": (0.9, 1.1), "2": (0.9, 1.1)}, operation="scale"),
  "gravity": randomize_field("opt.gravity", ".*", (-0.2, 0.2), operation="add"),
}
FULL = ("friction of all geoms", "pseudo-inertia of all bodies", "armature", "gains", "feedback gains")
"""What is drawn at every reset in the comparison of step rates, beside encoder bias, delays and pushes.

Friction loss, which the G1 has none of, would add a constraint for every joint: another model, not another draw.
"""
LAG = 3
"""Most physics steps that targets are late by."""


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("task")
  parser.add_argument("--num-envs", type=int, default=4096)
  parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
  parser.add_argument("--steps", type=int, default=100)
  parser.add_argument("--repeats", type=int, default=5)
  parser.add_argument("--output", type=Path, help="folder to write the tables to")
  args = parser.parse_args()
  events = cost_of_events(args.task, args.num_envs, args.device, args.repeats)
  print("\n".join(events), flush=True)
  rates = step_rates(args.task, args.num_envs, args.device, args.steps, args.repeats)
  print("\n".join(rates), flush=True)
  if args.output:
    args.output.mkdir(parents=True, exist_ok=True)
    path = args.output / f"randomization_{args.task}_{args.device.split(':')[0]}.md"
    text = [heading(f"Cost of randomising: {args.task}, {args.num_envs} worlds", args.device), "", *events, "", *rates]
    path.write_text("\n".join(text) + "\n")
    print(f"wrote {path}")


def make(task: str, num_envs: int, device: str, *, kind: str) -> Any:
  """Build the task's environment: "plain" has no randomisation, "full" has all of it at every reset."""
  from mjlab.registry import load_task
  from mjlab_envs import ManagerBasedRlEnv, mdp
  from mjlab_managers import EventTermCfg

  cfg = load_task(task).env
  cfg.scene.num_envs = num_envs
  cfg.seed = 1
  own = {name: event for name, event in cfg.events.items() if event.func is not mdp.randomize}
  if kind == "plain":
    cfg.events = own
  else:
    full = {name: EventTermCfg(mdp.randomize, mode="reset", params={"randomizer": EVENTS[name]}) for name in FULL}
    bias = cfg.events.get("encoder_bias")
    if bias is not None:
      bias.mode = "reset"
      full["encoder_bias"] = bias
    cfg.events = {**own, **full}
    robot = cfg.scene.entities["robot"]
    delay: dict[str, Any] = {"delay_min_lag": 0, "delay_max_lag": LAG, "delay_hold_prob": 1.0}
    late = tuple(replace(servo, **delay) for servo in robot.articulation.actuators)
    cfg.scene.entities["robot"] = replace(robot, articulation=replace(robot.articulation, actuators=late))
  return ManagerBasedRlEnv(cfg, device)


def cost_of_events(task: str, num_envs: int, device: str, repeats: int) -> list[str]:
  """Return a table of every event's time."""
  lines = ["| event | numbers per world | draw and write [ms] | with what follows [ms] | in few worlds [ms] |"]
  lines += ["|---|---|---|---|---|"]
  for name, cfg in EVENTS.items():
    env = make(task, num_envs, device, kind="plain")
    sim = env.sim
    term = RandomizeField(cfg, sim, generator=env.rng)
    every = torch.ones(num_envs, dtype=torch.bool, device=sim.device)
    few = torch.arange(num_envs, device=sim.device) % 100 == 0
    times = []
    for mask, recompute in ((every, False), (every, True), (few, True)):
      graph = sim.capture(lambda m=mask, r=recompute, t=term: t.apply(m, recompute=r), generators=(env.rng,))
      for _ in range(5):
        graph()
      times.append(1e3 * timed(graph, 20, repeats, sim.device))
    lines.append(f"| {name} | {len(term.components)} | " + " | ".join(f"{ms:.3f}" for ms in times) + " |")
    env.close()
  return lines


def step_rates(task: str, num_envs: int, device: str, steps: int, repeats: int) -> list[str]:
  """Return a table of step rates without and with randomisation, measured in turns."""
  envs = {kind: make(task, num_envs, device, kind=kind) for kind in ("plain", "full")}
  samples: dict[str, list[float]] = {kind: [] for kind in envs}
  action = torch.zeros(num_envs, envs["plain"].action_manager.total_action_dim, device=envs["plain"].device)
  for env in envs.values():
    env.reset()
    for _ in range(20):
      env.step(action.normal_())
  for _ in range(repeats):
    for kind, env in envs.items():
      synchronize(env.device)
      begin = time.perf_counter()
      for _ in range(steps):
        env.step(action.normal_())
      synchronize(env.device)
      samples[kind].append((time.perf_counter() - begin) / steps)
  lines = ["| events | step [ms] | env steps/s | share of plain |", "|---|---|---|---|"]
  plain = statistics.median(samples["plain"])
  for kind in envs:
    time_of = statistics.median(samples[kind])
    lines.append(f"| {kind} | {1e3 * time_of:.3f} | {num_envs / time_of:.0f} | {plain / time_of:.3f} |")
    envs[kind].close()
  drawn = f"{', '.join(FULL)}, encoder bias, lags of 0 to {LAG} physics steps"
  lines += ["", f"full: {drawn}, at every reset; pushes in both."]
  return lines


if __name__ == "__main__":
  main()
