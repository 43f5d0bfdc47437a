"""Actions: from the policy's output to what drives the simulation."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Set
from dataclasses import dataclass
from typing import Any

import torch
from mjlab_core.masking import fill_
from mjlab_core.state import Stateful

from mjlab_managers.env import ManagerEnv
from mjlab_managers.manager import ManagerBase, is_float
from mjlab_managers.table import table


@dataclass(kw_only=True)
class ActionTermCfg(ABC):
  """Base of action configs."""

  entity: str
  """Entity that the action drives."""

  @abstractmethod
  def build(self, env: Any) -> ActionTerm:
    """The term, on an environment whose scene is initialised."""


class ActionTerm(Stateful, ABC):
  """Base of action terms: `process_actions` once per step, `apply_actions` before every physics substep."""

  name: str = ""
  _constants = frozenset({"_raw_action"})
  # The manager's memory, where the raw action is saved.
  _raw_action: torch.Tensor

  def __init__(self, cfg: ActionTermCfg, env: Any) -> None:
    self.cfg, self.env = cfg, env
    self.num_envs, self.device = env.num_envs, env.device

  @property
  @abstractmethod
  def action_dim(self) -> int:
    """Number of action columns."""

  @property
  def driven(self) -> Set[str]:
    """What the term writes ("robot/hip" ...); two terms that drive the same thing are an error."""
    return frozenset()

  @property
  def raw_action(self) -> torch.Tensor:
    """This term's columns of the policy's output, float32 (N, action_dim)."""
    return self._raw_action

  @abstractmethod
  def process_actions(self, actions: torch.Tensor) -> None:
    """Takes the policy's output, float32 (N, action_dim), finite."""

  @abstractmethod
  def apply_actions(self) -> None:
    """Writes targets for the coming physics substep."""

  def reset(self, mask: torch.Tensor) -> None:
    """Forgets what belongs to the episodes of the worlds in `mask`, bool (N,)."""
    del mask


class ActionManager(ManagerBase[ActionTermCfg]):
  """Splits the action among its terms and keeps the last three raw actions."""

  cfg_type = ActionTermCfg
  _extra_state = ("_nonfinite",)

  def __init__(self, cfgs: Mapping[str, ActionTermCfg | None], env: ManagerEnv) -> None:
    super().__init__(cfgs, env)
    self._terms: dict[str, ActionTerm] = {}
    driver: dict[str, str] = {}
    for name, cfg in self._cfgs.items():
      term = self._build(name, cfg)
      if term is None:
        continue
      self._terms[name] = term
      shared: dict[str, list[str]] = {}
      for target in sorted(term.driven):
        if target in driver:
          shared.setdefault(driver[target], []).append(target)
        driver.setdefault(target, name)
      for other, targets in shared.items():
        self._problem(f"terms '{other}' and '{name}' both drive {', '.join(targets)}.")
    self._raise_problems()

    self.action_term_dim = [term.action_dim for term in self._terms.values()]
    self.total_action_dim = sum(self.action_term_dim)
    # Newest first. One block, so that a reset is one operation.
    self._history = torch.zeros(self.num_envs, 3, self.total_action_dim, device=self.device)
    self._frames = tuple(self._history[:, age] for age in range(3))
    self._nonfinite = torch.zeros((), dtype=torch.int64, device=self.device)
    start = 0
    for term, width in zip(self._terms.values(), self.action_term_dim, strict=True):
      term._raw_action = self._frames[0][:, start : start + width]
      start += width

  @property
  def action(self) -> torch.Tensor:
    """Raw action of this step, zero after a reset, float32 (N, total_action_dim)."""
    return self._frames[0]

  @property
  def prev_action(self) -> torch.Tensor:
    """Raw action of the step before, (N, total_action_dim)."""
    return self._frames[1]

  @property
  def prev_prev_action(self) -> torch.Tensor:
    """Raw action two steps before, (N, total_action_dim)."""
    return self._frames[2]

  def get_term(self, name: str) -> ActionTerm:
    """A term; UnknownNameError with the nearest names if there is none such."""
    return self._lookup(self._terms, name)

  def term_slices(self) -> dict[str, slice]:
    """Columns of each term in the action."""
    slices, start = {}, 0
    for name, width in zip(self._terms, self.action_term_dim, strict=True):
      slices[name] = slice(start, start + width)
      start += width
    return slices

  def process_action(self, action: torch.Tensor) -> None:
    """Takes the policy's output, (N, total_action_dim); NaN and infinite entries count as 0.

    Raises:
      ValueError: wrong shape or type; nothing has changed then.
    """
    if action.shape != self.action.shape or not is_float(action.dtype):
      widths = ", ".join(f"{n} {w}" for n, w in zip(self._terms, self.action_term_dim, strict=True))
      raise ValueError(
        f"action: expected float {tuple(self.action.shape)} ({widths or 'no terms'}), "
        f"got {str(action.dtype).removeprefix('torch.')} {tuple(action.shape)}."
      )
    if not self._terms:
      return
    newest, previous, oldest = self._frames
    oldest.copy_(previous)
    previous.copy_(newest)
    action = action.to(torch.float32)
    torch.nan_to_num(action, nan=0.0, posinf=0.0, neginf=0.0, out=newest)
    self._nonfinite.add_((newest != action).sum())
    for term in self._terms.values():
      term.process_actions(term._raw_action)

  def apply_action(self) -> None:
    """Has every term write its targets; call before every physics substep."""
    for term in self._terms.values():
      term.apply_actions()

  def reset(self, mask: torch.Tensor) -> None:
    """Zeroes the action history of the worlds in `mask`, bool (N,)."""
    fill_(self._history, mask, 0.0)
    super().reset(mask)

  def log_tensors(self) -> tuple[list[str], torch.Tensor]:
    """`Nonfinite/action`: entries replaced by 0; NaN where there were none."""
    count = self._nonfinite.double().reshape(1)
    return ["Nonfinite/action"], count.masked_fill(count == 0, torch.nan)

  def clear_log(self) -> None:
    self._nonfinite.zero_()

  def terms(self, env_idx: int) -> list[tuple[str, list[float]]]:
    values = self.action[env_idx].tolist()
    return [(name, values[columns]) for name, columns in self.term_slices().items()]

  def describe(self) -> str:
    rows = zip(self._terms, self.action_term_dim, strict=True)
    return table(f"Actions ({self.total_action_dim})", ("term", "width"), rows)
