"""Stored states of worlds, as an environment that viewers play."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import torch

from mjlab_viewer.pictures.offscreen import OffscreenRenderer
from mjlab_viewer.pictures.video import VideoFile
from mjlab_viewer.snapshot import FIELDS, HostWorld, Snapshot, SnapshotTaker, copy_world


class Replay:
  """Environment that shows one stored moment after another, again and again; the page can go to any of them.

  Args:
    model: Model of the worlds.
    moments: Fields of MjData by name, (moments, num_envs, ...), at least `qpos`. Poses of bodies follow from these;
      other fields have MuJoCo's initial values.
    step_dt: Time from one moment to the next [s].
    model_fields: Fields of MjModel with a value for each world, (num_envs, ...).
    moment: Word for a moment, as the page shows it: "clip walk, frame".
  """

  def __init__(
    self,
    model: mujoco.MjModel,
    moments: Mapping[str, np.ndarray],
    step_dt: float,
    model_fields: Mapping[str, np.ndarray] | None = None,
    *,
    moment: str = "moment",
  ) -> None:
    self._moment = moment
    self.num_steps, self.num_envs = moments["qpos"].shape[:2]
    """Moments, and worlds."""
    self.step_dt = step_dt
    self._given = tuple(moments)
    own = {} if model_fields is None else model_fields
    self._moments = {name: torch.from_numpy(value) for name, value in _completed(model, moments, own).items()}
    self.at = 0
    """Number of the moment that is shown."""
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
    self.show(0)

  def step(self, action: object) -> tuple[dict[str, Any], torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]:
    """Show the next moment; the first one follows the last, as a new episode."""
    del action
    self.show((self.at + 1) % self.num_steps)
    zeros = torch.zeros(self.num_envs)
    is_over = torch.full((self.num_envs,), self.at == 0)
    return {}, zeros, is_over, torch.zeros_like(is_over), {}

  def note(self, world: int) -> str:
    """Return what is shown of a world, one line."""
    where = f", world {world}" if self.num_envs > 1 else ""
    return f"{self._moment} {self.at + 1} of {self.num_steps}, {self.at * self.step_dt:.2f} s{where}"

  def get_observations(self) -> dict[str, Any]:
    """Return no observations."""
    return {}

  def signals(self) -> dict[str, tuple[list[str], torch.Tensor]]:
    """Return the given positions, velocities and controls of the moment that is shown."""
    given = [name for name in ("qpos", "qvel", "ctrl") if name in self._given]
    values = {name: self._moments[name][self.at].flatten(1) for name in given}
    return {name: ([f"{name}[{i}]" for i in range(value.shape[1])], value) for name, value in values.items()}

  def drawers(self) -> dict[str, Any]:
    """Return no drawers."""
    return {}

  def default_drawers(self) -> tuple[str, ...]:
    """Return no names."""
    return ()

  def steering(self) -> dict[str, Any]:
    """Return no commands."""
    return {}

  def show(self, moment: int) -> None:
    """Show a moment by its number, the last one beyond it; `step` goes on from there."""
    self.at = min(max(moment, 0), self.num_steps - 1)
    # Copies, so that a push does not change the stored moments.
    vars(self.sim.data).update({name: moments[self.at].clone() for name, moments in self._moments.items()})

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
        self.show(step)
        file.add(renderer.render(taker.take(range(self.num_envs), apart=True)))
        on_frame(file.num_frames)
      file.close()
    except BaseException:
      file.discard()
      raise


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
