"""Signals, drawings and pictures of an environment for viewers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import torch
from mjlab_core import DebugDraw

if TYPE_CHECKING:
  from mjlab_viewer import ViewedEnv

  from mjlab_envs.base_env import ManagerBasedEnv
  from mjlab_envs.env_cfg import ViewerCfg

RenderMode = Literal["rgb_array"]
MOST_TILES = 4


def signals(env: ManagerBasedEnv) -> dict[str, tuple[Sequence[str], torch.Tensor]]:
  """Return the numbers to plot by group, names and values (num_envs, k): weighted rewards, commands and so on."""
  found: dict[str, tuple[Sequence[str], torch.Tensor]] = {}
  if env.reward_manager.active_terms:
    found["rewards"] = (env.reward_manager.active_terms, env.reward_manager.step_reward)
  for name in env.command_manager.active_terms:
    command = env.command_manager.get_command(name)
    found[f"command {name}"] = (_numbered(name, command[0].numel()), command.reshape(env.num_envs, -1))
  if env.termination_manager.active_terms:
    found["terminations"] = env.termination_manager.step_terms
  manager = env.observation_manager
  for group, value in manager.buffers.items():
    if isinstance(value, dict):
      terms = {f"{group}/{term}": tensor for term, tensor in value.items()}
      found |= {name: (_numbered(name, t[0].numel()), t.reshape(env.num_envs, -1)) for name, t in terms.items()}
    elif value.dim() == 2:
      names: list[str] = []
      for term, shape in zip(manager.active_terms[group], manager.group_obs_term_dim[group], strict=True):
        names += _numbered(term, int(np.prod(shape)))
      # Parts that are joined along another axis than the last have no names of their own.
      found[f"observations {group}"] = (
        names if len(names) == value.shape[1] else _numbered(group, value.shape[1]),
        value,
      )
  return found


def drawers(env: ManagerBasedEnv) -> dict[str, Callable[[DebugDraw], None]]:
  """Return the `debug_draw` of the commands, events and sensors that have one, by name."""
  parts: dict[str, Any] = {
    f"command {name}": env.command_manager.get_term(name) for name in env.command_manager.active_terms
  }
  parts |= {f"event {name}": env.event_manager.term(name).func for name in env.event_manager.active_terms}
  parts |= {f"sensor {name}": sensor for name, sensor in env.scene.sensors.items()}
  return {name: part.debug_draw for name, part in parts.items() if hasattr(part, "debug_draw")}


def default_drawers(env: ManagerBasedEnv) -> tuple[str, ...]:
  """Return the names of the commands and sensors with `debug_vis` in their configuration."""
  owners = ((name, getattr(draw, "__self__", None)) for name, draw in drawers(env).items())
  return tuple(name for name, owner in owners if getattr(getattr(owner, "cfg", None), "debug_vis", False))


def steering(env: ManagerBasedEnv) -> dict[str, Any]:
  """Return the commands that a user can steer, by name: those that have `axes`."""
  terms = {name: env.command_manager.get_term(name) for name in env.command_manager.active_terms}
  return {name: term for name, term in terms.items() if term.axes}


class Camera:
  """Camera of an environment, made at the first picture."""

  def __init__(self, env: ViewedEnv, viewer: ViewerCfg) -> None:
    try:
      from mjlab_viewer import OffscreenRenderer, SnapshotTaker
    except ImportError as error:
      raise RuntimeError(f"render_mode='rgb_array' needs the package mjlab-viewer ({error})") from error
    self._taker = SnapshotTaker(env)
    self._renderer = OffscreenRenderer(env.sim.mj_model, viewer.picture())
    self._worlds = tuple(range(min(env.num_envs, MOST_TILES)))
    self._drawers = env.default_drawers()

  def picture(self) -> np.ndarray:
    """Return a picture of the first worlds as tiles, (height, width, 3) uint8."""
    return self._renderer.render(self._taker.take(self._worlds, drawers=self._drawers, apart=True))

  def close(self) -> None:
    """Free the memory of OpenGL."""
    self._renderer.close()


def _numbered(name: str, count: int) -> list[str]:
  return [name] if count == 1 else [f"{name}[{i}]" for i in range(count)]
