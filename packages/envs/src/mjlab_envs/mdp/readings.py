"""Readings of a robot: joints, its root, native sensors, cameras."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

import mujoco
import torch
from mjlab_managers import Reading, SceneEntityCfg

if TYPE_CHECKING:
  from mjlab_sensors import CameraSensor

  from mjlab_envs.env import ManagerBasedRlEnv

# Native sensors that have another name on robots.
_NAMES = {
  "GYRO": ("imu/gyro", "rad/s"),
  "ACCELEROMETER": ("imu/accelerometer", "m/s^2"),
  "VELOCIMETER": ("estimate/linear_velocity", "m/s"),
}


def joints(env: "ManagerBasedRlEnv", entity: str, quantity: Literal["position", "velocity"]) -> Reading:
  """Return the reading of all joint positions of an entity, as its encoders give them, or of all joint velocities."""
  robot = env.scene[entity]
  names = tuple(robot.joint_names)
  attribute, unit = {"position": ("joint_pos_biased", "rad, m"), "velocity": ("joint_vel", "rad/s, m/s")}[quantity]
  is_scalar = getattr(robot.data, attribute).shape[1] == len(names)
  return Reading(
    name=f"joint/{quantity}" if entity == "robot" else f"{entity}/joint/{quantity}",
    read=lambda: getattr(robot.data, attribute),
    unit=unit,
    columns=names,
    origin={"quantity": f"joint_{quantity}", "name": robot.prefix} if is_scalar else None,
  )


def of_root(name: str, unit: str, attribute: str, quantity: str) -> Callable[..., Reading]:
  """Return a function that returns the reading of a vector of an entity's root in its own frame."""

  def reading(env: "ManagerBasedRlEnv", *, asset: SceneEntityCfg) -> Reading:
    robot = env.scene[asset.name]
    return Reading(
      name=name,
      read=lambda: getattr(robot.data, attribute),
      unit=unit,
      frame=robot.root_body_name,
      columns=("x", "y", "z"),
      origin={"quantity": quantity, "name": robot.prefix + robot.root_body_name, "object_type": "body"},
    )

  return reading


def pose_of(
  name: str, read: Callable[[], torch.Tensor], *, quantity: str, of: tuple[str, str], frame: str = ""
) -> Reading:
  """Return the reading of the position or orientation of a body or site in the frame of a body.

  Args:
    name: Name of the reading.
    read: Returns its present value.
    quantity: "position" or "orientation", a quaternion (w, x, y, z).
    of: "body" or "site", and its name in the model.
    frame: Name in the model of the body that is the frame; empty: the world.
  """
  return Reading(
    name=name,
    read=read,
    unit="m" if quantity == "position" else "",
    frame=frame or "world",
    columns=("x", "y", "z") if quantity == "position" else ("w", "x", "y", "z"),
    origin={"quantity": quantity, "object_type": of[0], "name": of[1], "relative_to": frame},
  )


def sensor_reading(env: "ManagerBasedRlEnv", sensor: str) -> Reading:
  """Return the reading of a native sensor of MuJoCo."""
  model = env.sim.mj_model
  kind = mujoco.mjtSensor(model.sensor(sensor).type[0]).name.removeprefix("mjSENS_")
  name, unit = _NAMES.get(kind, (f"sensor/{sensor.rpartition('/')[2]}", ""))
  site = model.site(model.sensor(sensor).objid[0]).name if name.startswith(("imu/", "estimate/")) else ""
  return Reading(
    name=name,
    read=lambda: env.scene[sensor].data,
    unit=unit,
    frame=site,
    origin={"quantity": "sensor", "name": sensor, "object_type": "sensor"},
  )


def image_of(camera: "CameraSensor", kind: Literal["rgb", "depth"], read: Callable[[], torch.Tensor]) -> Reading:
  """Return the reading of an image of a camera sensor: colours from 0 to 1, or depth [m], -1 where nothing is."""
  # The cameras of bundles draw no shadows.
  groups = camera.cfg.geom_groups
  origin = {"quantity": f"camera_{kind}", "object_type": "camera", "name": camera.camera_name}
  return Reading(
    name=f"camera/{camera.name}/{kind}",
    read=read,
    unit="m" if kind == "depth" else "1",
    origin=None if camera.cfg.use_shadows else {**origin, "geom_groups": () if groups is None else tuple(groups)},
  )


def selected(joint_ids: Any, default: torch.Tensor) -> Callable[[torch.Tensor], torch.Tensor]:
  """Return the computation that takes the columns of selected joints, less their defaults, (1, joints)."""
  columns = torch.arange(default.shape[1])
  chosen = columns[joint_ids if isinstance(joint_ids, slice) else torch.as_tensor(joint_ids).cpu()]
  offset = default.detach().cpu().float()[:, chosen]
  if torch.equal(chosen, columns):
    return lambda reading: reading - offset
  return lambda reading: reading.index_select(1, chosen) - offset
