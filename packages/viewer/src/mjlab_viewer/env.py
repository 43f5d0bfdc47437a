"""Interface of environments that a viewer shows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, TypeAlias

import mujoco
import torch
from mjlab_core import DebugDraw

Signals: TypeAlias = "Mapping[str, tuple[Sequence[str], torch.Tensor]]"
"""Numbers to plot by the name of their group: their names, and their live values, (num_envs, k)."""

Drawers: TypeAlias = "Mapping[str, Callable[[DebugDraw], None]]"
"""Functions that draw over the picture, by name."""


class ViewedEnv(Protocol):
  """Batch of worlds of one model. A viewer reads it; only a `Playback` calls `reset`, `step` and `get_observations`.

  A viewer reads these attributes of `sim`: `num_envs`; `device`; `mj_model`, the compiled model, which it copies;
  `data`, with fields of MjData as tensors, (num_envs, ...); `expanded_fields`, names of the model fields that have one
  value per world; `model[name]`, such a field as a tensor, (num_envs, ...); `contacts(world)`, the
  `mjlab_core.Contacts` of a world in its last physics step, or None to let MuJoCo compute them from the state shown.
  """

  @property
  def num_envs(self) -> int:
    """Number of worlds."""
    ...

  @property
  def step_dt(self) -> float:
    """Duration of one step [s]."""
    ...

  @property
  def sim(self) -> Any:
    """Simulation, with the attributes named above."""
    ...

  def signals(self) -> Signals:
    """Return the numbers to plot, for example under "rewards" the value of each term.

    Of "terminations", the reasons for which episodes ended in the last step, the page names the last that were true.
    """
    ...

  def drawers(self) -> Drawers:
    """Return the functions that draw, for example of sensors and commands."""
    ...

  def default_drawers(self) -> Sequence[str]:
    """Return the names of the drawers that are on by default."""
    ...

  def steering(self) -> Mapping[str, Any]:
    """Return the commands that a user can steer, by name.

    A command has `axes`, a sequence of (name, least value, greatest value), and `steer(world, values)`, which holds
    these values in one world until it is called with None.
    """
    ...

  def reset(self) -> Any:
    """Begin new episodes in all worlds."""
    ...

  def step(self, action: torch.Tensor, /) -> tuple[Any, torch.Tensor, torch.Tensor, torch.Tensor, Any]:
    """Advance all worlds; return (observations, reward, terminated, truncated, extras). Episodes that end restart."""
    ...

  def get_observations(self) -> Any:
    """Return the observations of the present state."""
    ...


def floating_dofs(model: mujoco.MjModel) -> int | None:
  """Return the first of the six degrees of freedom of the first body with a free joint, None without one."""
  free = (model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).nonzero()[0]
  return int(model.jnt_dofadr[free[0]]) if len(free) else None


def push(env: ViewedEnv, world: int, velocity: Sequence[float]) -> None:
  """Add a velocity, world frame (3,) [m/s], to the first body with a free joint of one world, which the model has."""
  first = floating_dofs(env.sim.mj_model)
  assert first is not None
  qvel: torch.Tensor = env.sim.data.qvel
  qvel[world, first : first + 3] += torch.as_tensor(velocity, dtype=qvel.dtype, device=qvel.device)
