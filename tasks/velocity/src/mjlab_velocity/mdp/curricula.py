"""Curricula of velocity tasks."""

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import torch
from mjlab_core import MjlabError, check_fields, require
from mjlab_managers import ManagerTermBase

from mjlab_velocity.mdp.command import Range, UniformVelocityCommand

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

_ROWS = ("lin_vel_x", "lin_vel_y", "ang_vel_z")


@dataclass(kw_only=True)
class VelocityStage:
  """Ranges from an environment step on; None keeps the range of the stage before."""

  step: int
  lin_vel_x: Range | None = None
  lin_vel_y: Range | None = None
  ang_vel_z: Range | None = None


class commands_vel(ManagerTermBase):
  """Widen the velocity command by stages of the step counter. Logs the upper bounds."""

  env: "ManagerBasedRlEnv"

  def __init__(self, env: "ManagerBasedRlEnv", *, command: str, stages: list[VelocityStage]) -> None:
    super().__init__(env)
    if not stages or stages[0].step != 0 or any(b.step <= a.step for a, b in pairwise(stages)):
      raise MjlabError(f"steps of stages must begin at 0 and rise, got {[s.step for s in stages]}")
    term = env.command_manager.get_term(command)
    self._term = require(term, UniformVelocityCommand, f"command '{command}' is not a UniformVelocityCommand")
    rows = [[getattr(self._term.cfg.ranges, name) for name in _ROWS]]
    for stage in stages:
      check_fields(stage, f"stage at step {stage.step}")
      rows.append([getattr(stage, name) or before for name, before in zip(_ROWS, rows[-1], strict=True)])
    self._table = torch.tensor(rows[1:], device=env.device)
    self._starts = torch.tensor([stage.step for stage in stages], device=env.device)

  def __call__(self, mask: torch.Tensor) -> dict[str, torch.Tensor]:
    del mask  # All worlds share the stage, which follows from the step counter.
    stage = (self.env.common_step_counter >= self._starts).sum(dim=0, keepdim=True)
    ranges = self._table.index_select(0, stage - 1)[0]
    self._term.ranges[:3].copy_(ranges)
    return {"lin_vel_x": ranges[0, 1], "lin_vel_y": ranges[1, 1], "ang_vel_z": ranges[2, 1]}
