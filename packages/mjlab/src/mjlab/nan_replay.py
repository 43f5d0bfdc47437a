"""The stored steps of worlds that diverged, as an environment that viewers can play."""

from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import torch
from mjlab_sim import NanDump

_GROUPS = ("qpos", "qvel", "ctrl")


class NanReplay:
  """Shows one stored physics step after another, then begins anew. Worlds with fewer steps wait at their first one.

  A state that is not finite cannot be shown: the last one that is stays.

  Args:
    dump: The worlds.
    in_mujoco_c: Show what MuJoCo C makes of the last steps instead of what was recorded.
  """

  def __init__(self, dump: NanDump, *, in_mujoco_c: bool = False) -> None:
    self.num_envs = len(dump.worlds)
    self.step_dt: float = dump.model.opt.timestep
    self.num_steps = max(world.num_steps for world in dump.worlds) + 1
    """Stored physics steps, and the result of the last."""
    self._model = dump.model
    worlds = [self._states(dump, row, in_mujoco_c) for row in range(self.num_envs)]
    self._frames = {name: torch.from_numpy(np.stack([world[name] for world in worlds], 1)) for name in worlds[0]}
    self._at = 0
    self.sim: Any = SimpleNamespace(
      num_envs=self.num_envs,
      device=torch.device("cpu"),
      mj_model=self._model,
      expanded_fields=tuple(dump.worlds[0].model_fields),
      model={
        name: torch.from_numpy(np.stack([world.model_fields[name] for world in dump.worlds]))
        for name in dump.worlds[0].model_fields
      },
      data=SimpleNamespace(),
    )
    self.reset()

  def reset(self) -> None:
    """Begin with the first stored step."""
    self._show(0)

  def step(self, action: object) -> tuple[dict[str, Any], torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]:
    """Go on by one physics step; after the last one the first comes again, as a new episode."""
    del action
    self._show((self._at + 1) % self.num_steps)
    zeros = torch.zeros(self.num_envs)
    is_over = torch.full((self.num_envs,), self._at == 0)
    return {}, zeros, is_over, torch.zeros_like(is_over), {}

  def get_observations(self) -> dict[str, Any]:
    """There are none."""
    return {}

  def signals(self) -> dict[str, tuple[list[str], torch.Tensor]]:
    """Positions, velocities and controls of the step that is shown."""
    values = {name: self._frames[name][self._at].flatten(1) for name in _GROUPS if name in self._frames}
    return {name: ([f"{name}[{i}]" for i in range(value.shape[1])], value) for name, value in values.items()}

  def drawers(self) -> dict[str, Any]:
    """Nobody draws."""
    return {}

  def drawn_at_first(self) -> tuple[str, ...]:
    return ()

  def steering(self) -> dict[str, Any]:
    """Nothing can be steered."""
    return {}

  def _show(self, step: int) -> None:
    self._at = step
    vars(self.sim.data).update({name: frames[step] for name, frames in self._frames.items()})

  def _states(self, dump: NanDump, row: int, in_mujoco_c: bool) -> dict[str, np.ndarray]:
    """All fields of MjData that viewers read of one world, (num_steps, ...)."""
    world = dump.worlds[row]
    fields = {name: np.concatenate((values, world.result[name][None])) for name, values in world.states.items()}
    if in_mujoco_c:
      fields["qpos"] = np.concatenate((fields["qpos"][:1], world.replay().qpos))
    missing = self.num_steps - len(fields["time"])
    fields = {name: np.concatenate((np.repeat(values[:1], missing, 0), values)) for name, values in fields.items()}
    model = dump.make_model(world)
    data = mujoco.MjData(model)
    for name in ("act", "ctrl", "mocap_pos", "mocap_quat", "eq_active"):
      fields.setdefault(name, np.zeros((self.num_steps, *np.shape(getattr(data, name)))))
    fields["xpos"], fields["xquat"] = (np.zeros((self.num_steps, model.nbody, width)) for width in (3, 4))
    for step in range(self.num_steps):
      for values in fields.values():
        values[step] = np.where(np.isfinite(values[step]), values[step], values[step - 1] if step else 0.0)
      data.qpos[:] = fields["qpos"][step]
      if model.nmocap:
        data.mocap_pos[:], data.mocap_quat[:] = fields["mocap_pos"][step], fields["mocap_quat"][step]
      mujoco.mj_kinematics(model, data)
      fields["xpos"][step], fields["xquat"][step] = data.xpos, data.xquat
    return fields
