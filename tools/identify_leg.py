"""Identification of a Go1 leg whose parameters are known: noise, quantisation, 100 Hz, a delay of 7 ms.

The record is made by MuJoCo C at 1 ms a step. Run it as `uv run python tools/identify_leg.py`; it prints the table of
docs/sysid.md.
"""

import copy
import dataclasses
import time

import mujoco
import numpy as np
from mjlab_actuators import ActuatorCfg, ActuatorSet
from mjlab_core.tables import table
from mjlab_robots.go1 import go1
from mjlab_sysid import Record, Robot, identify, parse_term, robot_on_stand

TIMESTEP, SUBSTEPS, DELAY = 0.001, 10, 7
NOISE, VELOCITY_NOISE, QUANTUM = 1e-3, 2e-2, 5e-4
POSE = {"FR_hip_joint": 0.1, "FR_thigh_joint": 0.9, "FR_calf_joint": -1.8}
FACTORS = {
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
}
"""True values, times those of the model."""
FIT = ("armature:.*", "frictionloss:.*", "viscous_damping:.*", "stiffness:FR_thigh_joint", "body_mass:FR_calf")


def leg() -> Robot:
  """Return the right front leg on the held trunk, with some friction and damping in every joint."""
  cfg = go1(meshes="never")
  assert cfg.articulation is not None
  spec = cfg.spec_fn()
  for name in ("FL_hip", "RR_hip", "RL_hip"):
    spec.delete(spec.body(name))
  for sensor in list(spec.sensors):
    spec.delete(sensor)
  actuators: tuple[ActuatorCfg, ...] = tuple(
    dataclasses.replace(given, target_names_expr=tuple(p.replace(".*", "FR", 1) for p in given.target_names_expr))
    for given in cfg.articulation.actuators
  )
  ActuatorSet(actuators).edit_spec(spec)
  spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
  for joint in POSE:
    spec.joint(joint).frictionloss = 0.1
    spec.joint(joint).damping[0] = 0.05
  return robot_on_stand(spec, actuators, pose=POSE, timestep=TIMESTEP, height=1.0)


def true_model(robot: Robot) -> mujoco.MjModel:
  """Return the model with the true parameters."""
  model = copy.copy(robot.model)
  for name, factor in FACTORS.items():
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


def record(robot: Robot, seed: int, seconds: float) -> Record:
  """Return a record of sums of sines."""
  random, model = np.random.default_rng(seed), true_model(robot)
  data = mujoco.MjData(model)
  data.qpos[:] = robot.pose
  order = [robot.joints.index(model.actuator(i).name) for i in range(model.nu)]
  rate, phase = random.uniform(0.3, 4.0, (5, 3)), random.uniform(0.0, 2.0 * np.pi, (5, 3))
  gain = random.uniform(0.02, 0.08, (5, 3))
  times = TIMESTEP * SUBSTEPS * np.arange(round(seconds / (TIMESTEP * SUBSTEPS)))
  waves = gain * (np.sin(2.0 * np.pi * rate * times[:, None, None] + phase) - np.sin(phase))
  commands = robot.pose + waves.sum(1)
  rows: list[np.ndarray] = []
  for step in range(len(times) * SUBSTEPS):
    if step % SUBSTEPS == 0:
      rows.append(np.stack((data.qpos, data.qvel)))
    data.ctrl[:] = commands[max(0, step - DELAY) // SUBSTEPS, order]
    mujoco.mj_step(model, data)
  position, velocity = np.stack(rows, 1)
  position = np.round((position + random.normal(0.0, NOISE, position.shape)) / QUANTUM) * QUANTUM
  velocity = velocity + random.normal(0.0, VELOCITY_NOISE, velocity.shape)
  signals = {"position_target": commands, "position": position, "velocity": velocity}
  return Record(source=f"record {seed}", joints=robot.joints, time=times, signals=signals)


def main() -> None:
  robot = leg()
  terms = [parse_term(text) for text in (*FIT, "delay:.*=0..0.03,shared")]
  begin = time.monotonic()
  found = identify(robot, [record(robot, 0, 20.0)], terms, held_out=[record(robot, 1, 4.0)])
  seconds = time.monotonic() - begin
  rows = []
  for parameter, number, spread, told in zip(found.parameters, found.numbers, found.spread, found.told, strict=True):
    true = FACTORS.get(parameter.name, DELAY * TIMESTEP)
    shown = f"{100.0 * (number / true - 1.0):+.1f}" if told else "not told"
    rows.append((parameter.name, f"{true:g}", f"{number:.4g}", shown, f"{100.0 * spread / true:.1f}"))
  print(table(("parameter", "true", "found", "error [%]", "std [%]"), rows))
  errors = [(score.record, score.joint, f"{score.before:.4f}", f"{score.after:.4f}") for score in found.scores]
  print(table(("record", "joint", "error before [rad]", "after [rad]"), errors))
  print(f"{seconds:.0f} s")


if __name__ == "__main__":
  main()
