"""Stored states of worlds, as an environment that viewers play."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import torch

from mjlab_viewer.host_world import HostWorld, copy_world
from mjlab_viewer.pictures.offscreen import OffscreenRenderer
from mjlab_viewer.pictures.video import VideoFile
from mjlab_viewer.snapshot import FIELDS, Snapshot, SnapshotTaker


class Replay:
  """Environment that shows one stored moment after another, again and again; the page can set its time.

  Args:
    model: Model of the worlds.
    moments: Fields of MjData by name, (moments, num_envs, ...), at least `qpos`. Poses of bodies follow from these;
      other fields have MuJoCo's initial values.
    step_dt: Time from one moment to the next [s].
    model_fields: Fields of MjModel with a value for each world, (num_envs, ...).
  """

  def __init__(
    self,
    model: mujoco.MjModel,
    moments: Mapping[str, np.ndarray],
    step_dt: float,
    model_fields: Mapping[str, np.ndarray] | None = None,
  ) -> None:
    self.num_steps, self.num_envs = moments["qpos"].shape[:2]
    """Moments, and worlds."""
    self.step_dt = step_dt
    self._given = tuple(moments)
    own = {} if model_fields is None else model_fields
    self._moments = {name: torch.from_numpy(value) for name, value in _completed(model, moments, own).items()}
    self._at = 0
    self._held: int | None = None
    self.sim: Any = SimpleNamespace(
      num_envs=self.num_envs,
      device=torch.device("cpu"),
      mj_model=model,
      expanded_fields=tuple(own),
      model={name: torch.from_numpy(value) for name, value in own.items()},
      data=SimpleNamespace(),
      # MuJoCo C computes contacts from the moment that is shown.
      contacts=lambda world: None,
    )
    self.reset()

  def reset(self) -> None:
    """Show the first moment."""
    self._show(0 if self._held is None else self._held)

  def step(self, action: object) -> tuple[dict[str, Any], torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]:
    """Show the next moment; the first one follows the last, as a new episode."""
    del action
    self._show((self._at + 1) % self.num_steps if self._held is None else self._held)
    zeros = torch.zeros(self.num_envs)
    is_over = torch.full((self.num_envs,), self._at == 0 and self._held is None)
    return {}, zeros, is_over, torch.zeros_like(is_over), {}

  @property
  def at(self) -> int:
    """Number of the moment that is shown."""
    return self._at

  def note(self, world: int) -> str:
    """Return a note about a world at the moment that is shown, one line."""
    del world
    return f"moment {self.at + 1} of {self.num_steps}"

  def get_observations(self) -> dict[str, Any]:
    """Return no observations."""
    return {}

  def signals(self) -> dict[str, tuple[list[str], torch.Tensor]]:
    """Return the given positions, velocities and controls of the moment that is shown."""
    given = [name for name in ("qpos", "qvel", "ctrl") if name in self._given]
    values = {name: self._moments[name][self._at].flatten(1) for name in given}
    return {name: ([f"{name}[{i}]" for i in range(value.shape[1])], value) for name, value in values.items()}

  def drawers(self) -> dict[str, Any]:
    """Return no drawers."""
    return {}

  def default_drawers(self) -> tuple[str, ...]:
    """Return no names."""
    return ()

  def steering(self) -> dict[str, Replay]:
    """Return the time as a command."""
    return {"time": self}

  @property
  def axes(self) -> list[tuple[str, float, float]]:
    """Time since the first moment [s], as the axis of a command."""
    return [("time [s]", 0.0, (self.num_steps - 1) * self.step_dt)]

  def steer(self, world: int, values: Sequence[float] | None) -> None:
    """Hold all worlds at a time [s]; None continues."""
    del world
    self._held = None if values is None else min(max(round(values[0] / self.step_dt), 0), self.num_steps - 1)
    if self._held is not None:
      self._show(self._held)

  def film(
    self,
    path: str | os.PathLike[str],
    renderer: OffscreenRenderer,
    *,
    speed: float = 1.0,
    every: int = 1,
    on_frame: Callable[[int], None] = lambda frame: None,
  ) -> None:
    """Film all moments, with a tile for each world. The file appears whole or not at all, and replaces another.

    Args:
      path: FILE.mp4.
      renderer: Renderer of the same model.
      speed: Seconds of simulated time for each second of the film.
      every: Number of moments from one frame to the next.
      on_frame: Called after each frame with the number of frames.
    """
    taker = SnapshotTaker(self)
    file = VideoFile(path, fps=speed / (every * self.step_dt))
    try:
      for step in range(0, self.num_steps, every):
        self._show(step)
        file.add(renderer.render(taker.take(range(self.num_envs), apart=True)))
        on_frame(file.num_frames)
      file.close()
    except BaseException:
      file.discard()
      raise

  def _show(self, step: int) -> None:
    self._at = step
    # Copies, so that a push does not change the stored moments.
    vars(self.sim.data).update({name: moments[step].clone() for name, moments in self._moments.items()})


def _completed(
  model: mujoco.MjModel, given: Mapping[str, np.ndarray], model_fields: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
  """Return all fields of MjData that viewers read, (moments, num_envs, ...)."""
  steps, worlds = given["qpos"].shape[:2]
  rest = mujoco.MjData(model)
  fields = {}
  for name in FIELDS:
    shape = np.shape(getattr(rest, name))
    value = given[name] if name in given else np.broadcast_to(getattr(rest, name), (steps, worlds, *shape))
    fields[name] = np.array(value).reshape(steps, worlds, *shape)
  world = HostWorld(model)
  for step in range(steps):
    data = {name: value[step] for name, value in fields.items()}
    moment = Snapshot(worlds=tuple(range(worlds)), data=data, model=dict(model_fields), signals={}, drawings=[])
    for row in range(worlds):
      copy_world(moment, row, world.model, world.data)
      mujoco.mj_kinematics(world.model, world.data)
      data["xpos"][row], data["xquat"][row] = world.data.xpos, world.data.xquat
  return fields
