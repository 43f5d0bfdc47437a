"""What a viewer needs of an environment, and nothing more."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, TypeAlias

import mujoco
import torch
from mjlab_core import DebugDraw

Signals: TypeAlias = "Mapping[str, tuple[Sequence[str], torch.Tensor]]"
"""Numbers to plot by the name of their group: their names, and their live values, (num_envs, k)."""

Drawers: TypeAlias = "Mapping[str, Callable[[DebugDraw], None]]"
"""Who draws over the picture, by name."""


class SimulatedContacts(Protocol):
  """Contacts of one world as the simulation computed them."""

  @property
  def found(self) -> torch.Tensor:
    """Which rows are contacts, bool (n,)."""
    ...

  @property
  def geom(self) -> torch.Tensor:
    """The two geoms, -1 for a flex, (n, 2)."""
    ...

  @property
  def pos(self) -> torch.Tensor:
    """World frame, (n, 3) [m]."""
    ...

  @property
  def normal(self) -> torch.Tensor:
    """Unit normal from the first geom to the second, world frame, (n, 3)."""
    ...

  @property
  def force(self) -> torch.Tensor:
    """What the first geom exerts on the second, world frame, (n, 3) [N]."""
    ...


class ViewedSim(Protocol):
  """Many worlds of one model."""

  @property
  def num_envs(self) -> int: ...

  @property
  def device(self) -> torch.device: ...

  @property
  def mj_model(self) -> mujoco.MjModel:
    """The compiled model. Viewers copy it and leave it as it is."""
    ...

  @property
  def expanded_fields(self) -> Sequence[str]:
    """Model fields that have one value per world."""
    ...

  @property
  def data(self) -> Any:
    """Fields of MjData as tensors, (num_envs, ...)."""
    ...

  @property
  def model(self) -> Any:
    """Fields of MjModel as tensors by `model[name]`, (num_envs, ...) where expanded."""
    ...

  def contacts(self, world: int, /) -> SimulatedContacts | None:
    """Contacts of one world in its last physics step; None where MuJoCo is to compute them from the state shown."""
    ...


class ViewedEnv(Protocol):
  """A batch of worlds that can be watched while somebody else steps it."""

  @property
  def num_envs(self) -> int: ...

  @property
  def step_dt(self) -> float:
    """Duration of one step [s]."""
    ...

  @property
  def sim(self) -> ViewedSim: ...

  def signals(self) -> Signals:
    """What can be plotted, for example under "rewards" the value of each term.

    Of "terminations", the reasons for which episodes ended in the last step, the page names the last that were true.
    """
    ...

  def drawers(self) -> Drawers:
    """Who draws: sensors their rays, commands their arrows."""
    ...

  def drawn_at_first(self) -> Sequence[str]:
    """Names of those who draw unless told otherwise."""
    ...


class Steering(Protocol):
  """A command that can be given by hand."""

  @property
  def axes(self) -> Sequence[tuple[str, float, float]]:
    """Name, least and greatest value of each component."""
    ...

  def steer(self, world: int, values: Sequence[float] | None) -> None:
    """Give one world this command until it is taken back with None."""
    ...


class PlayedEnv(ViewedEnv, Protocol):
  """A batch of worlds that a viewer steps; worlds whose episode ended begin anew by themselves."""

  def steering(self) -> Mapping[str, Steering]:
    """Commands that can be given by hand, by name."""
    ...

  def reset(self) -> Any:
    """Begin new episodes in all worlds."""
    ...

  def step(self, action: torch.Tensor, /) -> tuple[Any, torch.Tensor, torch.Tensor, torch.Tensor, Any]:
    """Advance all worlds; returns (observations, reward, terminated, truncated, extras)."""
    ...

  def get_observations(self) -> Any:
    """Observations of the present state."""
    ...


class Policy(Protocol):
  """Actions for observations. One that remembers also has `reset(dones)`, with dones a bool mask (num_envs,)."""

  def __call__(self, observations: Any, /) -> torch.Tensor: ...
