"""Signals, drawings and pictures of an environment for viewers."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import torch
from mjlab_core import DebugDraw

from mjlab_envs.base_env import ManagerBasedEnv

if TYPE_CHECKING:
  from mjlab_viewer import ViewedEnv

  from mjlab_envs.env_cfg import ViewerCfg

RenderMode = Literal["rgb_array"]
MOST_TILES = 4


class ViewableEnv(ManagerBasedEnv):
  """Signals, drawings and commands of an environment, as viewers ask for them."""

  def signals(self) -> dict[str, tuple[Sequence[str], torch.Tensor]]:
    """Return the numbers to plot by group, for example "rewards": names and live values, (num_envs, k)."""
    found: dict[str, tuple[Sequence[str], torch.Tensor]] = {}
    if self.reward_manager.active_terms:
      found["rewards"] = (self.reward_manager.active_terms, self.reward_manager.step_reward)
    for name in self.command_manager.active_terms:
      found[f"command {name}"] = _columns(name, self.command_manager.get_command(name))
    if self.termination_manager.active_terms:
      found["terminations"] = self.termination_manager.step_terms
    manager = self.observation_manager
    for group, value in manager.buffers.items():
      if isinstance(value, dict):
        found |= {f"{group}/{term}": _columns(f"{group}/{term}", tensor) for term, tensor in value.items()}
      elif value.dim() == 2:
        terms = manager.layout(group)
        names = [name for term in terms for name in _numbered(term.name, math.prod(term.shape))]
        found[f"observations {group}"] = names, value
    return found

  def drawers(self) -> dict[str, Callable[[DebugDraw], None]]:
    """Return the functions that draw over pictures by name: `debug_draw` of commands, events and sensors."""
    commands, events = self.command_manager, self.event_manager
    parts: dict[str, Any] = {f"command {name}": commands.get_term(name) for name in commands.active_terms}
    parts |= {f"event {name}": events.term(name).func for name in events.active_terms}
    parts |= {f"sensor {name}": sensor for name, sensor in self.scene.sensors.items()}
    return {name: part.debug_draw for name, part in parts.items() if hasattr(part, "debug_draw")}

  def default_drawers(self) -> tuple[str, ...]:
    """Return the names of the commands and sensors with `debug_vis` in their configuration."""
    owners = ((name, getattr(draw, "__self__", None)) for name, draw in self.drawers().items())
    return tuple(name for name, owner in owners if getattr(getattr(owner, "cfg", None), "debug_vis", False))

  def steering(self) -> dict[str, Any]:
    """Return the commands that a user can steer, by name: those that have `axes`."""
    terms = {name: self.command_manager.get_term(name) for name in self.command_manager.active_terms}
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


def _columns(name: str, values: torch.Tensor) -> tuple[list[str], torch.Tensor]:
  """Return values with one column for each number of a world, and the names of the columns."""
  flat = values.flatten(1) if values.dim() > 1 else values.unsqueeze(1)
  return _numbered(name, flat.shape[1]), flat


def _numbered(name: str, count: int) -> list[str]:
  return [name] if count == 1 else [f"{name}[{i}]" for i in range(count)]
