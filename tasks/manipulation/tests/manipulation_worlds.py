"""Environments of the lift task, and chosen states."""

import itertools
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import torch
from mjlab_envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab_managers import ObservationTermCfg
from mjlab_manipulation import lift_cube_env
from mjlab_manipulation.lift import COMMAND, lift_env
from mjlab_manipulation.mdp import LiftCommand, Region
from mjlab_manipulation.objects import cube_spec
from mjlab_scene import EntityCfg

COLOURS = ("red", "green", "blue")


def three_cubes() -> ManagerBasedRlEnvCfg:
  """An environment with three cubes, without a camera."""
  cfg = lift_env({name: EntityCfg(spec_fn=cube_spec) for name in COLOURS})
  command: Any = cfg.commands[COMMAND]
  command.start = Region(x=(0.25, 0.4), y=(-0.103, 0.103), z=(0.0, 0.03))
  return cfg


def lift(
  num_envs: int, make: Callable[[], ManagerBasedRlEnvCfg] = lift_cube_env, **command: Any
) -> tuple[ManagerBasedRlEnv, LiftCommand]:
  """An environment that was reset, and its command, of whose config some fields may be others."""
  cfg = make()
  cfg.scene.num_envs, cfg.seed = num_envs, 11
  for name, value in command.items():
    setattr(cfg.commands[COMMAND], name, value)
  env = ManagerBasedRlEnv(cfg, device="cpu")
  env.reset()
  term: Any = env.command_manager.get_term(COMMAND)
  return env, term


def place(env: ManagerBasedRlEnv, position: np.ndarray, entity: str = "cube", world: slice = slice(None)) -> None:
  """Put an object, at rest and upright, at a position from each world's origin, (num_envs, 3) [m]."""
  mask = torch.zeros(env.num_envs, dtype=torch.bool)
  mask[world] = True
  state = torch.zeros(env.num_envs, 13, dtype=torch.float64)
  state[:, :3] = env.scene.env_origins + torch.as_tensor(position)
  state[:, 3] = 1.0
  env.scene[entity].write_root_state(state, mask)


def image_cfg(cfg: ManagerBasedRlEnvCfg) -> ObservationTermCfg:
  """The observation of a task that is images."""
  group: Any = cfg.observations["camera"]
  term: Any = group.terms["image"]
  return term


def images(env: ManagerBasedRlEnv) -> np.ndarray:
  """What the policies see now, (num_envs, channels, height, width)."""
  env.observation_manager.compute()
  seen: Any = env.get_observations()["camera"]
  assert seen.dtype == torch.float32
  return seen.numpy().copy()


def in_mujoco(env: ManagerBasedRlEnv, world: int) -> mujoco.MjData:
  data = mujoco.MjData(env.sim.mj_model)
  data.qpos[:] = env.sim.data.qpos[world].numpy()
  data.qvel[:] = env.sim.data.qvel[world].numpy()
  data.mocap_pos[:] = env.sim.data.mocap_pos[world].numpy()
  data.mocap_quat[:] = env.sim.data.mocap_quat[world].numpy()
  mujoco.mj_forward(env.sim.mj_model, data)
  return data


def room_in_sight(env: ManagerBasedRlEnv, start: Region, edges: tuple[float, ...]) -> float:
  """How far the image reaches beyond a box that begins in a region, where it is least, as a share of half the image.

  What a pinhole sees is a cone of flat sides, so that for every yaw the least is at a corner of the region.
  """
  data, model = in_mujoco(env, 0), env.sim.mj_model
  camera = data.camera("robot/camera_d405")
  # The image is square: the lens's horizontal field of view is wider.
  limit = np.tan(0.5 * np.radians(model.cam_fovy[camera.id]))
  corners = 0.5 * np.array(list(itertools.product((-1, 1), repeat=3))) * edges
  yaw = np.radians(np.arange(0, 360, 2))
  turned = np.stack([np.cos(yaw), -np.sin(yaw)], -1), np.stack([np.sin(yaw), np.cos(yaw)], -1)
  x, y = (corners[:, :2] @ row.T for row in turned)
  box = np.stack([x, y, np.broadcast_to(corners[:, 2:] + 0.5 * edges[2], x.shape)], -1).reshape(-1, 3)
  places = np.array(list(itertools.product(start.x, start.y, start.z)))[:, None] + env.scene.env_origins[0].numpy()
  seen = (box + places - camera.xpos) @ camera.xmat.reshape(3, 3)
  assert (seen[..., 2] < 0.0).all()
  return float(1.0 - (np.abs(seen[..., :2]) / -seen[..., 2:]).max() / limit)


def metric(env: ManagerBasedRlEnv, name: str) -> torch.Tensor:
  """What a metric is in the step just done, (num_envs,)."""
  manager = env.metrics_manager
  return torch.tensor([dict(manager.terms(world))[name][0] for world in range(env.num_envs)])
