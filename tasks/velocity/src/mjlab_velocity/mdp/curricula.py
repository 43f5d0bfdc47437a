"""Curricula of velocity tasks."""

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import torch
from mjlab_core.sampling import check_range
from mjlab_managers import CurriculumTermCfg, ManagerTermBase

from mjlab_velocity.mdp.command import Range, UniformVelocityCommand

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

_ROWS = ("lin_vel_x", "lin_vel_y", "ang_vel_z")


@dataclass(kw_only=True)
class VelocityStage:
  """Ranges that hold from an environment step on; None keeps those of the stage before."""

  step: int
  lin_vel_x: Range | None = None
  lin_vel_y: Range | None = None
  ang_vel_z: Range | None = None


class commands_vel(ManagerTermBase):
  """Widen the velocity command by stages of the step counter. Logs the upper bounds."""

  # The stage follows from the step counter at every step.
  _constants = frozenset({"_table", "_starts", "_stage"})

  def __init__(self, cfg: CurriculumTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    stages: list[VelocityStage] = cfg.params["stages"]
    if not stages or stages[0].step != 0 or any(b.step <= a.step for a, b in pairwise(stages)):
      raise ValueError(f"stages must begin at step 0 and follow in order, got steps {[s.step for s in stages]}")
    term = env.command_manager.get_term(cfg.params["command"])
    if not isinstance(term, UniformVelocityCommand):
      raise ValueError(f"command '{cfg.params['command']}' is a {type(term).__name__}, not a UniformVelocityCommand")
    self._term = term
    rows = [[getattr(term.cfg.ranges, name) for name in _ROWS]]
    for stage in stages:
      for name in _ROWS:
        if getattr(stage, name) is not None:
          check_range(f"stage at step {stage.step}: {name}", *getattr(stage, name))
      rows.append([getattr(stage, name) or before for name, before in zip(_ROWS, rows[-1], strict=True)])
    self._table = torch.tensor(rows[1:], device=env.device)
    self._starts = torch.tensor([stage.step for stage in stages], device=env.device)
    self._stage = torch.zeros(1, dtype=torch.int64, device=env.device)

  def __call__(
    self, env: "ManagerBasedRlEnv", mask: torch.Tensor, *, command: str, stages: list[VelocityStage]
  ) -> dict[str, torch.Tensor]:
    del mask, command, stages  # All worlds share the stage; the rest was resolved at build.
    torch.sum(env.common_step_counter >= self._starts, dim=0, keepdim=True, out=self._stage)
    ranges = self._table.index_select(0, self._stage - 1)[0]
    self._term.ranges[:3].copy_(ranges)
    return {"lin_vel_x": ranges[0, 1], "lin_vel_y": ranges[1, 1], "ang_vel_z": ranges[2, 1]}
