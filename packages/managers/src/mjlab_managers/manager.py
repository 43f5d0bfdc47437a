"""What all managers have in common."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

import torch
from mjlab_core.names import UnknownNameError, unknown
from mjlab_core.state import Stateful

from mjlab_managers.binding import Term, bind, copy_cfg
from mjlab_managers.env import ManagerEnv
from mjlab_managers.errors import ConfigError
from mjlab_managers.term import ManagerTermBaseCfg

CfgT = TypeVar("CfgT")


class ManagerBase(Stateful, Generic[CfgT]):
  """A set of named terms over one environment.

  Configs are copied; entries that are None are left out. All that is wrong with them is raised at once.

  Args:
    cfgs: term configs by name.
    env: the environment.

  Raises:
    ConfigError: a config is wrong; one line per mistake, with manager and term.
  """

  cfg_type: ClassVar[type]
  _children = ("_stateful_terms",)

  def __init__(self, cfgs: Mapping[str, CfgT | None], env: ManagerEnv) -> None:
    self.env = env
    self.num_envs, self.device = env.num_envs, torch.device(env.device)
    self._stateful_terms: dict[str, Stateful] = {}
    self._resets: list[Callable[[torch.Tensor], Any]] = []
    self._problems: list[str] = []
    self._cause: BaseException | None = None
    self._cfgs: dict[str, CfgT] = {}
    for name, cfg in cfgs.items():
      if cfg is None:
        continue
      if not isinstance(cfg, self.cfg_type):
        self._problems.append(f"term '{name}': expected a {self.cfg_type.__name__}, got {described(cfg)}.")
        continue
      self._cfgs[name] = copy_cfg(cfg)

  # What the user asks.

  @property
  def label(self) -> str:
    """The manager's name in messages."""
    return type(self).__name__

  @property
  def active_terms(self) -> Any:
    """Names of the terms, in order."""
    return list(self._cfgs)

  def get_term_cfg(self, name: str, /) -> CfgT:
    """The live config of a term; its values may be changed on the host.

    Raises:
      UnknownNameError: no such term.
    """
    return self._lookup(self._cfgs, name)

  def describe(self) -> str:
    """A table of the terms."""
    raise NotImplementedError

  def terms(self, env_idx: int) -> list[tuple[str, list[float]]]:
    """Name and current values of each term in one world, for viewers; reads from the device."""
    del env_idx
    return []

  # What the environment calls.

  def reset(self, mask: torch.Tensor) -> None:
    """Ends the episodes of the worlds in `mask`, bool (N,): logs what belongs to them and forgets it."""
    for reset in self._resets:
      reset(mask)

  def sync(self) -> None:
    """Host side, before each step: notices what was changed in the live configs, asks for a new recording if needed."""
    for term in self._watched_terms():
      if term.params_changed():
        self.env.request_recapture(f"{self.label}: parameters of '{term.name}' changed")

  def log_tensors(self) -> tuple[list[str], torch.Tensor]:
    """Log keys and values, float64 (K,), since `clear_log`; NaN where nothing happened. Does not read them."""
    return [], torch.zeros(0, dtype=torch.float64, device=self.device)

  def clear_log(self) -> None:
    """Begins a new log interval."""

  # What the managers share.

  def _watched_terms(self) -> Sequence[Term]:
    return ()

  def _lookup(self, table: Mapping[str, Any], name: str) -> Any:
    if name not in table:
      raise UnknownNameError(unknown("term", name, list(table), owner=self.label))
    return table[name]

  def _problem(self, text: str, cause: BaseException | None = None) -> None:
    self._problems.append(text)
    self._cause = self._cause or cause

  def _raise_problems(self) -> None:
    if self._problems:
      error, cause = ConfigError(self.label, self._problems), self._cause
      # A live config can be put right after a failed `sync`.
      self._problems, self._cause = [], None
      raise error from cause

  def _bind(self, name: str, cfg: ManagerTermBaseCfg, *, masked: bool = False) -> Term | None:
    term = bind(name, cfg, self.env, self._problems, masked=masked)
    if term is not None:
      self._adopt(name, term.func)
    return term

  def _adopt(self, name: str, obj: Any) -> None:
    """Registers what a term remembers for saving and for resets."""
    if isinstance(obj, Stateful):
      self._stateful_terms[name] = obj
    if not isinstance(obj, type) and callable(reset := getattr(obj, "reset", None)):
      self._resets.append(reset)

  def _build(self, name: str, cfg: Any) -> Any:
    """What `cfg.build(env)` returns, or None with the mistake noted."""
    try:
      obj = cfg.build(self.env)
    except Exception as error:
      self._problem(f"term '{name}': {error}", error)
      return None
    obj.name = name
    self._adopt(name, obj)
    return obj

  def _dry_run(self, term: Term, *args: Any) -> Any:
    """Calls a term once and leaves what it remembers as it was; None with the mistake noted if it raises."""
    func: Any = term.func
    state = func.state_dict() if isinstance(func, Stateful) else None
    try:
      value = term(*args)
    except Exception as error:
      self._problem(f"term '{term.name}': {type(error).__name__} in a trial call{_place(error)}: {error}", error)
      return None
    if state is None:
      return value
    try:
      func.load_state_dict(state)
    except ValueError as error:
      self._problem(f"term '{term.name}': what it remembers must be made in __init__, not when called: {error}", error)
    return value

  def _check_tensor(self, name: str, value: Any, what: str, fits: Callable[[torch.dtype], bool]) -> bool:
    if not isinstance(value, torch.Tensor):
      self._problem(f"term '{name}': must return {what}, returned {described(value)}.")
    elif not fits(value.dtype) or value.device.type != self.device.type:
      self._problem(f"term '{name}': must return {what} on {self.device}, returned {described(value)}.")
    else:
      return True
    return False

  def _bind_vectors(self: ManagerBase[Any], dtype_name: str, fits: Callable[[torch.dtype], bool]) -> list[Term]:
    """The terms, each of which returns one number per world; raises all problems up to here."""
    terms: list[Term] = []
    for name, cfg in self._cfgs.items():
      term = self._bind(name, cfg)
      if term is not None:
        terms.append(term)
        self._check_vector(term, dtype_name, fits)
    self._raise_problems()
    return terms

  def _check_vector(self, term: Term, dtype_name: str, fits: Callable[[torch.dtype], bool]) -> None:
    """Runs a term dry and checks that it returns one number per world."""
    before = len(self._problems)
    value = self._dry_run(term)
    if len(self._problems) > before:
      return
    what = f"{dtype_name} ({self.num_envs},)"
    if self._check_tensor(term.name, value, what, fits) and value.shape != (self.num_envs,):
      self._problem(f"term '{term.name}': must return {what}, returned {described(value)}.")


def is_float(dtype: torch.dtype) -> bool:
  """Whether it is a real floating-point type."""
  return dtype.is_floating_point


def described(value: Any) -> str:
  """A value in a message: of a tensor its type, shape and place."""
  if isinstance(value, torch.Tensor):
    return f"{str(value.dtype).removeprefix('torch.')} {tuple(value.shape)} on {value.device}"
  return f"{type(value).__name__} {value!r}" if isinstance(value, int | float | str) else type(value).__name__


def _place(error: Exception) -> str:
  """Where in a term it was raised, or by what the term called: " (my_terms.py, line 12)"."""
  here = Path(__file__).parent
  for frame in traceback.extract_tb(error.__traceback__):
    path = Path(frame.filename)
    if path.parent != here:
      return f" ({path.name}, line {frame.lineno})"
  return ""
