"""Small robots on stands, and their records from a loop of MuJoCo."""

import copy
from collections.abc import Callable, Mapping
from typing import Any

import mujoco
import numpy as np
import torch
from mjlab_actuators import ActuatorCfg, ActuatorSet, NativePositionActuatorCfg
from mjlab_core.rotations import quat_box_plus
from mjlab_sysid import Record, Robot, robot_on_ground, robot_on_stand

TIMESTEP, PERIOD = 0.002, 0.01
SERVOS: tuple[ActuatorCfg, ...] = (
  NativePositionActuatorCfg(
    target_names_expr=(".*",), stiffness=20.0, damping=0.5, effort_limit=30.0, armature=0.02, frictionloss=0.1
  ),
)
ARM = """
<mujoco>
  <option integrator="implicitfast"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <freejoint/>
      <geom type="box" size="0.05 0.05 0.05" mass="5"/>
      <site name="trunk"/>
      <body name="thigh">
        <joint name="hip" axis="0 1 0" damping="0.1" range="-120 120"/>
        <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.25" mass="1" contype="0" conaffinity="0"/>
        <body name="shank" pos="0 0 -0.25">
          <joint name="knee" axis="0 1 0" damping="0.1" range="-150 150"/>
          <geom type="capsule" size="0.015" fromto="0 0 0 0 0 -0.2" mass="0.4" contype="0" conaffinity="0"/>
          <geom name="foot" type="sphere" size="0.02" pos="0 0 -0.22" mass="0.1" condim="3"/>
          <site name="tip" pos="0 0 -0.2" euler="0 90 0"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def arm(actuators: tuple[ActuatorCfg, ...] = SERVOS, is_free: bool = False, **stand: Any) -> Robot:
  spec = mujoco.MjSpec.from_string(ARM)
  ActuatorSet(actuators).edit_spec(spec)
  settings: dict[str, Any] = {"timestep": TIMESTEP} | stand
  return (robot_on_ground if is_free else robot_on_stand)(spec, actuators, **settings)


def changed(robot: Robot, factors: Mapping[str, float]) -> mujoco.MjModel:
  """Return the model with fields of elements multiplied: {"dof_armature:hip": 1.5}."""
  model = copy.copy(robot.model)
  for name, factor in factors.items():
    field, element = name.split(":")
    if field in ("stiffness", "damping"):
      actuator = model.actuator(element)
      if field == "stiffness":
        actuator.gainprm[0] *= factor
      actuator.biasprm[1 if field == "stiffness" else 2] *= factor
      continue
    kind = "joint" if field.startswith("dof") else field.partition("_")[0]
    index = model.joint(element).dofadr[0] if kind == "joint" else getattr(model, kind)(element).id
    getattr(model, field)[index] *= factor
  mujoco.mj_setConst(model, mujoco.MjData(model))
  return model


def sines(robot: Robot, seed: int, seconds: float, size: float = 0.12) -> np.ndarray:
  """Return targets of every row: sums of sines about the pose, which is the first row."""
  random = np.random.default_rng(seed)
  addresses, _ = robot.addresses(robot.joints)
  count = len(robot.joints)
  rate, phase = random.uniform(0.3, 4.0, (6, count)), random.uniform(0.0, 2.0 * np.pi, (6, count))
  gain = random.uniform(0.3, 1.0, (6, count)) * size
  time = PERIOD * np.arange(round(seconds / PERIOD))[:, None, None]
  waves = gain * (np.sin(2.0 * np.pi * rate * time + phase) - np.sin(phase))
  return robot.pose[addresses] + waves.sum(1) * np.minimum(1.0, time[..., 0])


def record(
  robot: Robot,
  model: mujoco.MjModel,
  commands: np.ndarray,
  *,
  delay: int = 0,
  noise: float = 0.0,
  quantum: float = 0.0,
  bias: float = 0.0,
  source: str = "record",
  signals: tuple[str, ...] = ("position", "velocity"),
  controller: Callable[..., np.ndarray] | None = None,
) -> Record:
  """Record a model; `delay` in timesteps, `bias` of all encoders, signal "imu" for both signals of the IMU.

  `controller` of targets, positions and velocities gives the controls of motors; without it, targets are controls.
  """
  data = mujoco.MjData(model)
  data.qpos[:] = robot.pose
  addresses, dofs = robot.addresses(robot.joints)
  substeps = round(PERIOD / model.opt.timestep)
  order = [robot.joints.index(model.actuator(i).name) for i in range(model.nu)]
  held = np.repeat(commands, substeps, 0)[:, order]
  rows: list[Any] = []
  body: list[Any] = []
  before = np.zeros(0)
  for step in range(len(held)):
    if step % substeps == 0:
      rows.append(np.concatenate((data.qpos[addresses], data.qvel[dofs])))
      before = data.qpos[:7].copy()
    data.ctrl[:] = held[max(0, step - delay)] - bias
    if controller is not None:
      data.ctrl[:] = controller(data.ctrl, data.qpos[addresses][order], data.qvel[dofs][order])
    mujoco.mj_step(model, data)
    if step % substeps == 0:
      rows[-1] = np.concatenate((rows[-1], data.qfrc_actuator[dofs]))
      # A step leaves sensors as they were at its beginning.
      body.append(np.concatenate((before, data.sensordata)))
  position, velocity, effort = np.split(np.array(rows, dtype=np.float64), 3, axis=1)
  others = np.array(body)
  random = np.random.default_rng(99)
  position = position + bias + noise * random.normal(size=position.shape)
  position = np.round(position / quantum) * quantum if quantum else position
  velocity = velocity + 20.0 * noise * random.normal(size=velocity.shape)
  measured = {"position": position, "velocity": velocity, "effort": effort}
  if "imu" in signals:
    imu = others[:, -6:] + random.normal(size=(len(others), 6)) * ([0.01] * 3 + [0.1] * 3)
    measured |= {"angular_velocity": imu[:, :3], "linear_acceleration": imu[:, 3:]}
    signals = (*(name for name in signals if name != "imu"), "angular_velocity", "linear_acceleration")
  if robot.base:
    turns = quat_box_plus(
      torch.from_numpy(others[:, 3:7]), torch.from_numpy(noise * random.normal(size=(len(others), 3)))
    )
    measured |= {
      "base_position": others[:, :3] + noise * random.normal(size=(len(others), 3)),
      "base_orientation": turns.numpy(),
    }
    signals = (*signals, "base_position", "base_orientation")
  return Record(
    source=source,
    joints=robot.joints,
    time=PERIOD * np.arange(len(rows)),
    signals={"position_target": commands, **{name: measured[name] for name in signals}},
  )
