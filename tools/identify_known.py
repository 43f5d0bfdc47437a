"""Identification of robots whose parameters are known: noise, quantisation, 100 Hz, a delay of 7 ms.

The records are made by MuJoCo C at 1 ms a step: of a leg of the Go1, and of the arm YAM. One moves in sums of sines, or
two follow a designed excitation. It prints the tables of docs/sysid.md.

  uv run python tools/identify_known.py leg
  uv run python tools/identify_known.py leg --report leg.html --picture docs/pictures/sysid_report.png
  uv run python tools/identify_known.py yam
  uv run python tools/identify_known.py yam --motion designed
  uv run python tools/identify_known.py leg --engine warp --device cuda:0
"""

import argparse
import copy
import dataclasses
import io
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from mjlab_actuators import ActuatorCfg, ActuatorSet
from mjlab_core.io.tables import table
from mjlab_robots.go1 import go1
from mjlab_robots.yam import YAM_DEFAULT_JOINT_POS, yam
from mjlab_sysid import (
  ExcitationCfg,
  Identified,
  IdentifyCfg,
  Record,
  Robot,
  design_excitation,
  identify,
  parse_term,
  robot_on_stand,
  write_report,
)
from PIL import Image
from playwright.sync_api import sync_playwright

TIMESTEP, SUBSTEPS, DELAY = 0.001, 10, 7
NOISE, VELOCITY_NOISE, QUANTUM = 1e-3, 2e-2, 5e-4
DELAY_TERM = "delay:.*=0..0.03,shared"


@dataclass(frozen=True, kw_only=True)
class Known:
  """Robot with parameters to find."""

  robot: Callable[[], Robot]
  """Function that returns the robot as its model has it."""
  factors: Mapping[str, float]
  """True values, times those of the model, by field and element."""
  joints: tuple[str, ...]
  """Joints that move."""
  size: tuple[float, float]
  """Range of the amplitudes of five sines in a joint [rad]."""
  highest: float
  """Highest frequency [Hz]."""


def with_friction(
  spec: mujoco.MjSpec, actuators: tuple[ActuatorCfg, ...], pose: Mapping[str, float], joints: tuple[str, ...]
) -> Robot:
  """Return a robot on a stand, with some friction and damping in some joints."""
  ActuatorSet(actuators).edit_spec(spec)
  for sensor in list(spec.sensors):
    spec.delete(sensor)
  spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
  for joint in joints:
    spec.joint(joint).frictionloss = 0.1
    spec.joint(joint).damping[0] = 0.05
  return robot_on_stand(spec, actuators, pose=pose, timestep=TIMESTEP, height=1.0)


LEG_POSE = {"FR_hip_joint": 0.1, "FR_thigh_joint": 0.9, "FR_calf_joint": -1.8}


def leg() -> Robot:
  """Return the right front leg of the Go1 on the held trunk."""
  cfg = go1(meshes="never")
  assert cfg.articulation is not None
  spec = cfg.spec_fn()
  for name in ("FL_hip", "RR_hip", "RL_hip"):
    spec.delete(spec.body(name))
  actuators: tuple[ActuatorCfg, ...] = tuple(
    dataclasses.replace(given, target_names_expr=tuple(p.replace(".*", "FR", 1) for p in given.target_names_expr))
    for given in cfg.articulation.actuators
  )
  return with_friction(spec, actuators, LEG_POSE, tuple(LEG_POSE))


YAM_JOINTS = tuple(f"joint{i}" for i in range(1, 7))


def arm() -> Robot:
  """Return the YAM."""
  cfg = yam(meshes="never")
  assert cfg.articulation is not None
  return with_friction(cfg.spec_fn(), tuple(cfg.articulation.actuators), YAM_DEFAULT_JOINT_POS, YAM_JOINTS)


ROBOTS = {
  "leg": Known(
    robot=leg,
    factors={
      "dof_armature:FR_hip_joint": 1.6,
      "dof_armature:FR_thigh_joint": 0.6,
      "dof_armature:FR_calf_joint": 1.3,
      "dof_frictionloss:FR_hip_joint": 2.5,
      "dof_frictionloss:FR_thigh_joint": 1.7,
      "dof_frictionloss:FR_calf_joint": 3.0,
      "dof_damping:FR_hip_joint": 1.5,
      "dof_damping:FR_thigh_joint": 3.0,
      "dof_damping:FR_calf_joint": 2.0,
      "stiffness:FR_thigh_joint": 0.7,
      "body_mass:FR_calf": 1.4,
    },
    joints=tuple(LEG_POSE),
    size=(0.04, 0.14),
    highest=5.0,
  ),
  "yam": Known(
    robot=arm,
    factors={
      "dof_armature:joint1": 1.5,
      "dof_armature:joint2": 0.6,
      "dof_armature:joint3": 1.4,
      "dof_armature:joint6": 1.5,
      "dof_frictionloss:joint1": 2.5,
      "dof_frictionloss:joint2": 3.5,
      "dof_frictionloss:joint3": 1.7,
      "dof_frictionloss:joint4": 0.6,
      "dof_damping:joint5": 2.0,
      "stiffness:joint2": 0.8,
      "body_mass:link_4": 1.5,
    },
    joints=YAM_JOINTS,
    size=(0.08, 0.22),
    highest=5.0,
  ),
}


def true_model(robot: Robot, factors: Mapping[str, float]) -> mujoco.MjModel:
  """Return the model with the true parameters."""
  model = copy.copy(robot.model)
  for name, factor in factors.items():
    field, element = name.split(":")
    if field == "stiffness":
      index = model.actuator(element).id
      model.actuator_gainprm[index, 0] *= factor
      model.actuator_biasprm[index, 1] *= factor
    elif field == "body_mass":
      model.body_mass[model.body(element).id] *= factor
    else:
      getattr(model, field)[model.joint(element).dofadr[0]] *= factor
  mujoco.mj_setConst(model, mujoco.MjData(model))
  return model


def sines(known: Known, random: np.random.Generator, seconds: float) -> np.ndarray:
  """Return commands: sums of sines about the pose, (rows, joints)."""
  robot = known.robot()
  shape = (5, len(known.joints))
  rate, phase = random.uniform(0.3, known.highest, shape), random.uniform(0.0, 2.0 * np.pi, shape)
  gain = random.uniform(*known.size, shape)
  times = TIMESTEP * SUBSTEPS * np.arange(round(seconds / (TIMESTEP * SUBSTEPS)))
  waves = gain * (np.sin(2.0 * np.pi * rate * times[:, None, None] + phase) - np.sin(phase))
  return robot.pose[robot.addresses(known.joints)[0]] + waves.sum(1)


def record(known: Known, random: np.random.Generator, commands: np.ndarray, name: str) -> Record:
  """Return a noisy record of commands, (rows, joints)."""
  robot = known.robot()
  model, joints = true_model(robot, known.factors), known.joints
  data, (addresses, dofs) = mujoco.MjData(model), robot.addresses(joints)
  data.qpos[:] = robot.pose
  times = TIMESTEP * SUBSTEPS * np.arange(len(commands))
  moved = [model.actuator(joint).id for joint in joints]
  for i in range(model.nu):
    data.ctrl[i] = robot.pose[robot.addresses([model.actuator(i).name])[0][0]]
  rows: list[np.ndarray] = []
  for step in range(len(times) * SUBSTEPS):
    if step % SUBSTEPS == 0:
      rows.append(np.stack((data.qpos[addresses], data.qvel[dofs])))
    data.ctrl[moved] = commands[max(0, step - DELAY) // SUBSTEPS]
    mujoco.mj_step(model, data)
  position, velocity = np.stack(rows, 1)
  position = np.round((position + random.normal(0.0, NOISE, position.shape)) / QUANTUM) * QUANTUM
  velocity = velocity + random.normal(0.0, VELOCITY_NOISE, velocity.shape)
  signals = {"position_target": commands, "position": position, "velocity": velocity}
  return Record(source=name, joints=joints, time=times, signals=signals)


def sine_record(known: Known, seed: int, seconds: float) -> Record:
  """Return a record of sums of sines."""
  random = np.random.default_rng(seed)
  return record(known, random, sines(known, random, seconds), f"record {seed}")


def designed(known: Known, seconds: float) -> np.ndarray:
  """Return commands that identify the parameters well, (rows, joints), and print their information."""
  cfg = ExcitationCfg(seconds=seconds, period=TIMESTEP * SUBSTEPS, highest=known.highest, rounds=2, candidates=4)
  terms = [parse_term(text) for text in (*known.factors, DELAY_TERM)]
  found = design_excitation(known.robot(), terms, cfg, joints=known.joints)
  print(found.summary(), flush=True)
  return found.commands.of("position_target", known.joints)


def found_in(known: Known, records: Sequence[Record], cfg: IdentifyCfg | None = None) -> Identified:
  """Return the parameters found in records; another record is held out."""
  terms = [parse_term(text) for text in (*known.factors, DELAY_TERM)]
  return identify(known.robot(), records, terms, cfg, held_out=[sine_record(known, 1, 4.0)])


def photograph(page: Path, picture: Path) -> None:
  """Draw the tables, identifiability and the first record of a report."""
  with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
    tab = browser.new_page(viewport={"width": 1150, "height": 900})
    tab.goto(page.resolve().as_uri())
    second = tab.locator("h2").nth(2).bounding_box()
    height = round(second["y"]) if second else 1500
    image = Image.open(io.BytesIO(tab.screenshot(full_page=True)))
    browser.close()
  image.crop((0, 0, 1040, height)).convert("RGB").quantize(64).save(picture, optimize=True)


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("robot", choices=ROBOTS)
  parser.add_argument("--motion", choices=("sines", "designed"), default="sines")
  parser.add_argument("--engine", choices=("auto", "native", "warp"), default="auto")
  parser.add_argument("--device", default="cpu")
  parser.add_argument("--seconds", type=float, default=20.0)
  parser.add_argument("--report", type=Path, help="report to write, as HTML")
  parser.add_argument("--picture", type=Path, help="picture of the report's first page; needs Chromium")
  args = parser.parse_args()
  known = ROBOTS[args.robot]
  if args.motion == "sines":
    records = [sine_record(known, 0, args.seconds)]
  else:
    commands = designed(known, args.seconds)
    records = [record(known, np.random.default_rng(seed), commands, f"record {seed}") for seed in (0, 2)]
  begin = time.process_time(), time.monotonic()
  found = found_in(known, records, IdentifyCfg(engine=args.engine, device=args.device))
  spent = time.process_time() - begin[0], time.monotonic() - begin[1]
  rows = []
  for estimate in found.estimates:
    name, number = estimate.parameter.name, estimate.number
    true = known.factors.get(name, DELAY * TIMESTEP)
    shown = f"{100.0 * (number / true - 1.0):+.1f}", f"{100.0 * estimate.std / true:.1f}"
    rows.append((name, f"{true:g}", f"{number:.4g}", *(shown if estimate.identifiable else (estimate.reason, "-"))))
  print(table(("parameter", "true", "found", "error [%]", "std [%]"), rows))
  errors = [(trace.record, trace.joint, *(f"{error:.4f}" for error in trace.errors)) for trace in found.traces]
  print(table(("record", "joint", "error before [rad]", "after [rad]"), errors))
  if args.report:
    write_report(found, args.report)
    if args.picture:
      photograph(args.report, args.picture)
  print(f"{spent[0]:.0f} s of CPU time, {spent[1]:.0f} s")


if __name__ == "__main__":
  main()
