"""Actions: from the output of the policy to the targets of the simulation."""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from collections.abc import Set
from dataclasses import dataclass
from typing import Any

import torch
from mjlab_core import Config, fill_
from mjlab_core.io.tables import table

from mjlab_managers.manager import ManagerBase
from mjlab_managers.observations.deployment import ActionTargets
from mjlab_managers.terms.binding import call_named, named
from mjlab_managers.terms.term import ManagerTermBase
from mjlab_managers.vector_manager import nan_if_zero


@dataclass(kw_only=True)
class ActionTermCfg(Config, ABC):
  """Base of action configs."""

  entity: str
  """Entity that the action drives."""

  @abstractmethod
  def build(self, env: Any) -> ActionTerm:
    """Return the term for an environment whose scene is initialised."""


class ActionTerm(ManagerTermBase, ABC):
  """Base of action terms.

  The manager calls `process_actions` once per step and `apply_actions` before every physics substep. Subclasses declare
  state by `self.state(...)` in `__init__`.
  """

  # The manager's memory, where the raw action is saved.
  _raw_action: torch.Tensor

  def __init__(self, cfg: ActionTermCfg, env: Any) -> None:
    super().__init__(env)
    self.cfg = cfg

  @property
  @abstractmethod
  def action_dim(self) -> int:
    """Number of action columns."""

  @property
  def driven(self) -> Set[str]:
    """Names of the targets that the term writes, such as "robot/hip". Two terms must not write the same target."""
    return frozenset()

  @property
  def raw_action(self) -> torch.Tensor:
    """Columns of the policy's output that belong to this term, float32 (N, action_dim)."""
    return self._raw_action

  @abstractmethod
  def process_actions(self, actions: torch.Tensor) -> None:
    """Take the policy's output, float32 (N, action_dim), finite."""

  def exported(self) -> ActionTargets | None:
    """Return the computation of joint targets outside the simulation, or None if this action has none."""
    return None

  def apply_actions(self) -> None:
    """Write targets for the next physics substep. The default writes nothing: targets stay until they are replaced."""


class ActionManager(ManagerBase[ActionTermCfg]):
  """Manager that splits the action among its terms and keeps the last three raw actions."""

  cfg_type = ActionTermCfg

  def _mistake(self, term: ActionTerm) -> str:
    for name, other in self._terms.items():
      if shared := sorted(term.driven & other.driven):
        return f"terms '{name}' and '{term.name}' both drive {', '.join(shared)}."
    return ""

  def _make(self) -> None:
    self._applied = {n: t for n, t in self._terms.items() if type(t).apply_actions is not ActionTerm.apply_actions}
    self.action_term_dim = [term.action_dim for term in self._terms.values()]
    self.total_action_dim = sum(self.action_term_dim)
    # Newest first. One block, so that a reset is one operation.
    self._history = self.state((3, self.total_action_dim))
    self._frames = tuple(self._history[:, age] for age in range(3))
    self._nonfinite = self.state(dtype=torch.int64, shared=True)
    for name, columns in self.term_slices().items():
      self._terms[name]._raw_action = self._frames[0][:, columns]

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
    """Return a term.

    Raises:
      UnknownNameError: no such term; the message lists the nearest names.
    """
    return self.term(name)

  def term_slices(self) -> dict[str, slice]:
    """Return the columns of each term in the action."""
    ends = itertools.accumulate(self.action_term_dim)
    widths = zip(self._terms, self.action_term_dim, ends, strict=True)
    return {name: slice(end - width, end) for name, width, end in widths}

  def process_action(self, action: torch.Tensor) -> None:
    """Take the policy's output, (N, total_action_dim). NaN and infinite entries become 0."""
    newest, previous, oldest = self._frames
    oldest.copy_(previous)
    previous.copy_(newest)
    action = action.to(torch.float32)
    torch.nan_to_num(action, nan=0.0, posinf=0.0, neginf=0.0, out=newest)
    self._nonfinite.add_((newest != action).sum())
    for name, term in self._terms.items():
      try:  # without further calls, in every step
        term.process_actions(term._raw_action)
      except Exception as error:
        raise named(self.label, name, error) from error

  def apply_action(self) -> None:
    """Write the targets of every term. Call it before every physics substep."""
    for name, term in self._applied.items():
      call_named(self.label, name, term.apply_actions)

  def _rehearse(self, term: ActionTerm) -> None:
    with self._trial(term):
      term.process_actions(torch.zeros_like(term._raw_action))
      term.apply_actions()
      term.reset(self._everywhere)

  def reset(self, mask: torch.Tensor) -> None:
    """Set the action history of the worlds in `mask`, bool (N,), to zero, and reset the terms there."""
    fill_(self._history, mask, 0.0)
    super().reset(mask)

  def log_tensors(self) -> tuple[list[str], torch.Tensor]:
    """Return `Nonfinite/action`, the number of entries replaced by 0, or NaN if there were none."""
    return ["Nonfinite/action"], nan_if_zero(self._nonfinite.reshape(1))

  def clear_log(self) -> None:
    self._nonfinite.zero_()

  def terms(self, env_idx: int) -> list[tuple[str, list[float]]]:
    values = self.action[env_idx].tolist()
    return [(name, values[columns]) for name, columns in self.term_slices().items()]

  def describe(self) -> str:
    rows = zip(self._terms, self.action_term_dim, strict=True)
    return table(("term", "width"), rows, title=f"Actions ({self.total_action_dim})")
