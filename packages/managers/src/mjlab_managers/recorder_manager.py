"""Recorders: hooks that see what happens, on the host, outside the recorded step."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field
from typing import Any

import torch

from mjlab_managers.env import ManagerEnv
from mjlab_managers.manager import ManagerBase
from mjlab_managers.table import table


@dataclass
class RecorderTermCfg:
  """A recorder: `func` is a subclass of RecorderTerm, made with `(cfg, env)`."""

  func: type[RecorderTerm]
  _: KW_ONLY
  params: dict[str, Any] = field(default_factory=dict)
  """Options that the class reads from its config."""


class RecorderTerm:
  """Base of recorders. Hooks run eagerly, so they may read from the device; only those overridden cost anything."""

  name: str = ""

  def __init__(self, cfg: RecorderTermCfg, env: Any) -> None:
    self.cfg, self.env = cfg, env

  def pre_reset(self, mask: torch.Tensor) -> None:
    """Before the worlds in `mask`, bool (N,), are reset: their last action, reward and reason are still there."""

  def post_reset(self, mask: torch.Tensor) -> None:
    """After the worlds in `mask`, bool (N,), were reset and observed."""

  def post_step(self) -> None:
    """At the end of every step."""

  def close(self) -> None:
    """At the end of the run."""


class RecorderManager(ManagerBase[RecorderTermCfg]):
  """Calls the hooks of all recorders."""

  cfg_type = RecorderTermCfg

  def __init__(self, cfgs: Mapping[str, RecorderTermCfg | None], env: ManagerEnv) -> None:
    super().__init__(cfgs, env)
    self._terms: dict[str, RecorderTerm] = {}
    for name, cfg in self._cfgs.items():
      if not (isinstance(cfg.func, type) and issubclass(cfg.func, RecorderTerm)):
        self._problem(f"term '{name}': func must be a subclass of RecorderTerm, is {cfg.func!r}.")
        continue
      try:
        term = cfg.func(cfg, env)
      except Exception as error:
        self._problem(f"term '{name}': {type(error).__name__}: {error}", error)
        continue
      term.name = name
      self._terms[name] = term
    self._raise_problems()

  def get_term(self, name: str) -> RecorderTerm:
    """A recorder; UnknownNameError with the nearest names if there is none such."""
    return self._lookup(self._terms, name)

  def pre_reset(self, mask: torch.Tensor) -> None:
    """Calls `pre_reset(mask)` of the recorders that have it."""
    self._call("pre_reset", mask)

  def post_reset(self, mask: torch.Tensor) -> None:
    """Calls `post_reset(mask)` of the recorders that have it."""
    self._call("post_reset", mask)

  def post_step(self) -> None:
    """Calls `post_step()` of the recorders that have it."""
    self._call("post_step")

  def close(self) -> None:
    """Closes all recorders, also if one of them fails to."""
    with contextlib.ExitStack() as stack:
      for term in reversed(self._terms.values()):
        stack.callback(term.close)

  def _call(self, hook: str, *args: torch.Tensor) -> None:
    base = getattr(RecorderTerm, hook)
    terms = [term for term in self._terms.values() if getattr(type(term), hook) is not base]
    if not terms:
      return
    hooks: list[Callable[..., None]] = [getattr(term, hook) for term in terms]

    def call() -> None:
      for function in hooks:
        function(*args)

    self.env.run_eagerly(call, name=f"recorders {', '.join(term.name for term in terms)} ({hook})")

  def describe(self) -> str:
    return table("Recorders", ("term", "type"), [(name, type(term).__name__) for name, term in self._terms.items()])
