"""Simulations with sensors, and what their tests share."""

import inspect
import re
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import torch
from mjlab_sim import Simulation, SimulationCfg
from scipy.spatial.transform import Rotation

Count = Callable[[Callable[[], object]], int]
ENTITIES = {"robot": None}


def with_robot(robot: str, terrain: str, assets: str = "") -> mujoco.MjSpec:
  """A body `terrain` with these geoms, and a robot with the prefix of its entity."""
  spec = mujoco.MjSpec.from_string(
    f'<mujoco>{assets}<worldbody><body name="terrain">{terrain}</body></worldbody></mujoco>'
  )
  spec.attach(mujoco.MjSpec.from_string(robot), prefix="robot/", frame=spec.worldbody.add_frame())
  return spec


def simulate(
  spec: mujoco.MjSpec, *cfgs: Any, num_envs: int = 2, device: str = "cpu", seed: int = 0, **options: Any
) -> tuple[Simulation, list[Any]]:
  """A simulation with sensors; those without a name get one."""
  sensors = []
  for number, cfg in enumerate(cfgs):
    sensors.append(cfg.build("" if cfg.name else f"sensor{number}"))
    sensors[-1].edit_spec(spec, ENTITIES)
  sim = Simulation(num_envs, spec, SimulationCfg(num_threads=1, **options), device)
  rng = torch.Generator().manual_seed(seed)
  for sensor in sensors:
    sensor.rng = rng
    sensor.initialize(sim, ENTITIES)
  return sim, sensors


class World:
  """A simulation with its sensors by name, which step and reset together."""

  def __init__(self, spec: mujoco.MjSpec, *cfgs: Any, **options: Any) -> None:
    self.sim, sensors = simulate(spec, *cfgs, **options)
    self.sensors: dict[str, Any] = {sensor.name: sensor for sensor in sensors}

  def step(self, substeps: int = 1) -> None:
    advance(self.sim, self.sensors.values(), substeps)

  def reset(self, mask: torch.Tensor) -> None:
    self.sim.reset(mask)
    for sensor in self.sensors.values():
      sensor.reset(mask)


def advance(sim: Simulation, sensors: Any, substeps: int = 1) -> None:
  for _ in range(substeps):
    sim.step()
    for sensor in sensors:
      sensor.update(sim.timestep)


def place(sim: Simulation, *poses: tuple[Any, ...]) -> None:
  """Put the floating base of each world at x, y, z with a `Rotation`, or upright for None."""
  for world, (x, y, z, rotation) in enumerate(poses):
    quat = (rotation or Rotation.identity()).as_quat(scalar_first=True)
    sim.data.qpos[world, :7] = torch.tensor((x, y, z, *quat), dtype=sim.dtype)


def get(value: torch.Tensor | None) -> torch.Tensor:
  assert value is not None
  return value


def pixel_rays(
  model: mujoco.MjModel, data: mujoco.MjData, camera: int, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
  """Origins and directions of the pixels of MuJoCo's own image, from the frustum that it is drawn with, and the cosine
  to the optical axis; (height, width, ...)."""
  scene, view = mujoco.MjvScene(model, 100), mujoco.MjvCamera()
  view.type, view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, camera
  mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, view, 1, scene)
  eye = scene.camera[0]
  half = eye.frustum_width or 0.5 * (eye.frustum_top - eye.frustum_bottom) * width / height
  x = eye.frustum_center + half * (2.0 * (np.arange(width) + 0.5) / width - 1.0)
  y = eye.frustum_top + (np.arange(height) + 0.5) / height * (eye.frustum_bottom - eye.frustum_top)
  forward, up = np.array(eye.forward, dtype=np.float64), np.array(eye.up, dtype=np.float64)
  across = x[None, :, None] * np.cross(forward, up) + y[:, None, None] * up
  position = data.cam_xpos[camera]
  if eye.orthographic:
    return position + across, np.broadcast_to(forward, across.shape), np.ones(across.shape[:2])
  rays = eye.frustum_near * forward + across
  rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
  return np.broadcast_to(position, rays.shape), rays, rays @ forward


def documentation(reading: type, name: str) -> str:
  """Docstring of a field or property."""
  found = re.search(rf'  (?:def )?{name}\b[^\n]*\n +"""(.*?)"""', inspect.getsource(reading), re.DOTALL)
  assert found is not None, name
  return found[1]


class Sketch:
  """A viewer that keeps what is drawn."""

  worlds = (2, 0)

  def __init__(self) -> None:
    self.shapes: dict[str, list[tuple[Any, ...]]] = {}

  def __getattr__(self, shape: str) -> Any:
    return lambda *arguments: self.shapes.setdefault(shape, []).append(arguments)
