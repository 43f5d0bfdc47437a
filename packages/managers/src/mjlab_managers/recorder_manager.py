"""Recorders: hooks that observe a run on the host, outside the recorded step."""

from __future__ import annotations

import collections
import contextlib
import copy
from dataclasses import dataclass
from typing import Any

import torch

from mjlab_managers.manager import ManagerBase
from mjlab_managers.terms.binding import Term, call_named, placed
from mjlab_managers.terms.term import ManagerTermBase, ManagerTermBaseCfg


@dataclass
class RecorderTermCfg(ManagerTermBaseCfg):
  """Config of a recorder: `func` is a subclass of `RecorderTerm`."""


class RecorderTerm(ManagerTermBase):
  """Base of recorders, `__init__(self, env, *, ...)`.

  Hooks run outside the recorded step, so they may read from the device. Hooks that are not overridden cost nothing.
  Each hook is called once at build, on a copy of the recorder with `is_trial` True and its own lists, dictionaries and
  arrays. A hook that writes files should return without a write if `is_trial` is True.
  """

  is_trial: bool = False

  def pre_reset(self, mask: torch.Tensor) -> None:
    """Run before the reset of the worlds in `mask`, bool (N,), with their last action, reward and termination."""

  def post_reset(self, mask: torch.Tensor) -> None:
    """Run after the reset and observation of the worlds in `mask`, bool (N,)."""

  def post_step(self) -> None:
    """Run at the end of every step."""

  def close(self) -> None:
    """Run at the end of the run."""


class RecorderManager(ManagerBase[RecorderTermCfg]):
  """Manager that calls the hooks of all recorders."""

  cfg_type = RecorderTermCfg
  term_base = RecorderTerm

  @classmethod
  def _cfg_problems(cls, cfg: Any) -> list[str]:
    hooks = ("pre_reset", "post_reset", "post_step")
    former = [hook for hook in hooks if hasattr(getattr(cfg, "func", None), f"record_{hook}")]
    return super()._cfg_problems(cfg) + [
      f"method 'record_{hook}' of mjlab 1.x is called '{hook}' here." for hook in former
    ]

  def _rehearse(self, term: Term) -> None:
    twin = _twin(term.func)
    for hook, args in (("pre_reset", (self._everywhere,)), ("post_reset", (self._everywhere,)), ("post_step", ())):
      with placed(f"in {hook}"):
        getattr(twin, hook)(*args)

  def reset(self, mask: torch.Tensor) -> None:
    """Do nothing. Recorders have hooks for resets."""

  def get_term(self, name: str) -> RecorderTerm:
    """Return a recorder.

    Raises:
      UnknownNameError: no such recorder; the message lists the nearest names.
    """
    return self.term(name).func

  def pre_reset(self, mask: torch.Tensor) -> None:
    """Call `pre_reset(mask)` of the recorders that have it."""
    self._call("pre_reset", mask)

  def post_reset(self, mask: torch.Tensor) -> None:
    """Call `post_reset(mask)` of the recorders that have it."""
    self._call("post_reset", mask)

  def post_step(self) -> None:
    """Call `post_step()` of the recorders that have it."""
    self._call("post_step")

  def close(self) -> None:
    """Close all recorders, even if one of them raises an error."""
    with contextlib.ExitStack() as stack:
      for term in reversed(self._terms.values()):
        stack.callback(term.func.close)

  def _call(self, hook: str, *args: torch.Tensor) -> None:
    base = getattr(RecorderTerm, hook)
    names = [name for name, term in self._terms.items() if getattr(type(term.func), hook) is not base]
    if not names:
      return

    def call() -> None:
      for name in names:
        call_named(self.label, name, getattr(self._terms[name].func, hook), *args)

    self.env.run_eagerly(call, name=f"recorders {', '.join(names)} ({hook})")


def _twin(term: RecorderTerm) -> RecorderTerm:
  """Return a copy for a trial, with its own containers."""
  twin = copy.copy(term)
  vars(twin).update({name: _own(value) for name, value in vars(term).items() if name != "_registry"}, is_trial=True)
  return twin


def _own(value: Any) -> Any:
  if isinstance(value, torch.Tensor):
    return value.clone()
  if isinstance(value, list | set | collections.deque):
    return type(value)(_own(item) for item in value)
  if isinstance(value, dict):
    twin = copy.copy(value)
    twin.update({key: _own(item) for key, item in value.items()})
    return twin
  return copy.copy(value) if hasattr(value, "__array__") else value
