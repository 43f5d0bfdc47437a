"""Base of all managers: named terms, trial calls at build, state, and live changes."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, ClassVar, Generic, TypeVar

import torch
from mjlab_core import ConfigError, MjlabError, Stateful, StatefulDict, UnknownNameError, require, unknown
from mjlab_core.config import lock
from mjlab_core.errors import as_consequence, is_consequence
from mjlab_core.io.tables import table

from mjlab_managers.env import ManagerEnv
from mjlab_managers.terms.binding import Term, call_named, call_terms, cfg_problems, described, mask_problem, placed
from mjlab_managers.terms.term import ManagerTermBase, ManagerTermBaseCfg
from mjlab_managers.terms.watch import only_declared

CfgT = TypeVar("CfgT")


class ManagerBase(Stateful, Generic[CfgT]):
  """Set of named terms over one environment.

  Configs are copied. Entries that are None are left out.

  Args:
    cfgs: term configs by name.
    env: the environment.
    problems: list that receives one line per mistake, to report the mistakes of several managers together. The manager
      then consists of the terms without mistakes. None raises the mistakes.

  Raises:
    ConfigError: a config is wrong; one line per mistake, with manager and term.
  """

  cfg_type: ClassVar[Any]
  live_fields: ClassVar[frozenset[str]] = frozenset()
  """Fields of a term config that may be assigned after build."""
  term_base: ClassVar[type] = ManagerTermBase
  """Required base of class terms."""
  masked: ClassVar[bool] = False
  """True if terms take the worlds to act on."""

  def __init__(self, cfgs: Mapping[str, CfgT | None], env: ManagerEnv, *, problems: list[str] | None = None) -> None:
    self.env = env
    self.num_envs, self.device = env.num_envs, torch.device(env.device)
    self.evaluate: Callable[[Sequence[Term]], list[torch.Tensor]] = call_terms
    """Function that returns the values of terms in the step; the environment may set a compiled one."""
    self._everywhere = torch.ones(self.num_envs, dtype=torch.bool, device=self.device)
    self._terms: dict[str, Any] = {}
    self._stateful_terms: StatefulDict[ManagerTermBase] = StatefulDict()
    self._cfgs: dict[str, Any] = {}
    self._live: list[tuple[Any, frozenset[str]]] = []
    self._broken: set[str] = set()
    self._problems: list[str] = []
    self._cause: Exception | None = None
    for name, cfg in self._term_cfgs(cfgs):
      with self._noting(name):
        self._add(name, cfg)
      if name not in self._terms:
        self._broken.add(name)
        self._cfgs.pop(name, None)
        self._stateful_terms.pop(name, None)
    self._make()
    self._report(problems)

  @classmethod
  def check(cls, cfgs: Mapping[str, CfgT | None]) -> list[str]:
    """Return the mistakes in configs that show without an environment, one line each."""
    given = [(name, cfg) for name, cfg in cfgs.items() if cfg is not None]
    return [f"{cls.__name__}: term '{name}': {problem}" for name, cfg in given for problem in cls._cfg_problems(cfg)]

  @classmethod
  def _cfg_problems(cls, cfg: Any) -> list[str]:
    """Return the mistakes in the config of a term that show without an environment."""
    return cfg_problems(cfg, cls.cfg_type, cls.term_base, masked=cls.masked)

  # Interface for users.

  @property
  def label(self) -> str:
    """Name of the manager in messages."""
    return type(self).__name__

  @property
  def active_terms(self) -> Any:
    """Names of the terms in order."""
    return list(self._terms)

  def get_term_cfg(self, name: str, /) -> CfgT:
    """Return the config of a term. It is read-only except for `live_fields`; `set_params` changes parameters.

    Raises:
      UnknownNameError: no such term.
    """
    return self._lookup(self._cfgs, name)

  def term(self, name: str, /) -> Any:
    """Return a term: that of an action or command, or a callable with its parameters, with `mask` for events.

    Raises:
      UnknownNameError: no such term.
    """
    return self._lookup(self._terms, name)

  def set_params(self, name: str, /, **params: Any) -> None:
    """Change parameters of a term from the next step on.

    A number that the term takes as a scalar is written, and the recorded step stays valid. Any other change builds a
    class term again, keeps its state, and requests a new recording of the step.

    Args:
      name: name of the term.
      params: new values by name. Other parameters keep their values.

    Raises:
      UnknownNameError: no such term.
      ConfigError: a parameter does not exist or has a wrong value; nothing was changed.
    """
    term, is_rebuilt = self._with_params(name), False
    undo = term.snapshot()
    with self._noting(name):
      is_rebuilt = term.set_params(params)
      if is_rebuilt:
        self._refuse(term)
    if self._problems:
      undo()
    self._adopt(term)
    self._report()
    if is_rebuilt and not term.wants_ids:
      self.env.request_recapture(f"{self.label}: parameters of '{name}' changed")

  def scalar(self, name: str, parameter: str, /) -> torch.Tensor:
    """Return a scalar parameter of a term, float64, 0-d, that curricula may write inside the step.

    Neither the config of the term nor a checkpoint contains such writes. A curriculum keeps the value as its own state,
    or derives it from the step counter, and writes it in every step.

    Raises:
      UnknownNameError: no such term.
      MjlabError: no such parameter, or the term does not read it in every step.
    """
    return call_named(self.label, name, self._with_params(name).scalar, parameter)

  def describe(self) -> str:
    """Return a table of the terms and their configs."""
    fields = [field.name for field in dataclasses.fields(self.cfg_type) if field.name not in ("func", "params")]
    rows = []
    for name, cfg in self._cfgs.items():
      kind = getattr(cfg, "func", self._terms[name])
      rows.append((name, getattr(kind, "__name__", type(kind).__name__), *(getattr(cfg, field) for field in fields)))
    return table(("term", "type", *fields), rows, title=self.label)

  def terms(self, env_idx: int) -> list[tuple[str, list[float]]]:
    """Return name and current values of each term in one world, for viewers. It reads from the device."""
    del env_idx
    return []

  # Interface for the environment.

  def rehearse(self) -> None:
    """Call every term that was not called at build once for all worlds, and report errors like mistakes in configs.

    The state of terms is restored. The environment restores the simulation, the scene and the generator.
    """
    for name, term in self._terms.items():
      with self._noting(name):
        self._rehearse(term)
    self._report()

  def remember(self) -> Callable[[], None]:
    """Return a function that restores the present parameters, live fields of configs, and state."""
    state = self.state_dict()
    terms = [(term, dict(term.given), term.scalar_values()) for term in self._terms.values() if isinstance(term, Term)]
    fields = [(cfg, {name: getattr(cfg, name) for name in live}) for cfg, live in self._live]

    def put_back() -> None:
      for term, params, scalars in terms:
        if changed := {key: value for key, value in params.items() if term.given[key] is not value}:
          self.set_params(term.name, **changed)
        term.write_scalars(scalars)
      for cfg, values in fields:
        for name, value in values.items():
          setattr(cfg, name, value)
      self.restore(state)

    return put_back

  def reset(self, mask: torch.Tensor) -> None:
    """End the episodes of the worlds in `mask`, bool (N,): log their statistics and reset their state."""
    for name, term in self._stateful_terms.items():
      call_named(self.label, name, term.reset, mask)

  def sync(self) -> None:
    """Read changes of live fields, on the host before each step, and request a new recording if needed."""

  def log_tensors(self) -> tuple[list[str], torch.Tensor]:
    """Return log keys and values since `clear_log`, float64 (K,) on the device; NaN if nothing happened."""
    return [], torch.zeros(0, dtype=torch.float64, device=self.device)

  def clear_log(self) -> None:
    """Begin a new log interval."""

  # Interface for subclasses. Terms raise MjlabError for mistakes, and `_noting` collects them.

  def _term_cfgs(self, cfgs: Mapping[str, Any]) -> Iterable[tuple[str, Any]]:
    """Return name and config of the terms."""
    return [(name, cfg) for name, cfg in cfgs.items() if cfg is not None]

  def _make(self) -> None:
    """Make buffers and logs of the terms."""

  def _mistake(self, term: Any) -> str:
    """Return the reason why a term that was built or rebuilt does not work; empty if it works.

    Raises:
      MjlabError: the term failed in a trial call.
    """
    del term
    return ""

  def _rehearse(self, term: Any) -> None:
    """Call a term that `_mistake` does not call."""

  def _add(self, name: str, cfg: Any) -> None:
    if problems := self._cfg_problems(cfg):
      raise ConfigError(*problems)
    func = getattr(cfg, "func", None)
    # A function stays the same object, and so does the owner of a method.
    own = copy.deepcopy(cfg, {id(func): func})
    cfg = self._cfgs[name] = self._locked(name, own, self.live_fields)
    with placed("while making it"):
      if isinstance(own, ManagerTermBaseCfg):
        term = Term(name, self.label, cfg, own.params, self.env, masked=self.masked)
      else:
        term = cfg.build(self.env)
        term.name = name
        if problem := mask_problem(term):
          raise MjlabError(problem)
    self._adopt(term)
    self._refuse(term)
    self._terms[name] = term

  def _refuse(self, term: Any) -> None:
    if mistake := self._mistake(term):
      raise MjlabError(mistake)

  def _locked(self, name: str, cfg: Any, live: frozenset[str]) -> Any:
    """Return a read-only copy of a config."""
    ways = [f"assign {', '.join(sorted(live))}"] if live else []
    if isinstance(cfg, ManagerTermBaseCfg):
      ways.append(f"change its parameters by set_params('{name}', name=value)")
    way = ", or ".join(ways or ["write into a tensor of the term"])
    cfg = lock(cfg, f"{self.label}: '{name}' is built, and its config is read-only; {way}.", live)
    self._live.append((cfg, live))
    return cfg

  def _adopt(self, term: Any) -> None:
    """Register a term for saving and for resets."""
    obj = term.func if isinstance(term, Term) else term
    if isinstance(obj, ManagerTermBase):
      self._stateful_terms[term.name] = obj
      obj.state_dict()

  def _all_worlds(self, term: Term) -> torch.Tensor:
    """Return all worlds as a term takes them: as indices or as a mask."""
    return torch.arange(self.num_envs, device=self.device) if term.wants_ids else self._everywhere

  def _with_params(self, name: str) -> Term:
    return require(self.term(name), Term, f"{self.label}: term '{name}' has no parameters.")

  def _lookup(self, table: Mapping[str, Any], name: str) -> Any:
    if name in table:
      return table[name]
    error = UnknownNameError(unknown("term", name, list(table), owner=self.label))
    raise as_consequence(error) if name in self._broken else error

  @contextmanager
  def _noting(self, name: str, kind: str = "term") -> Generator[None]:
    """Note a mistake of a term, instead of raising it."""
    try:
      yield
    except MjlabError as error:
      if not is_consequence(error):
        lines = error.problems if isinstance(error, ConfigError) else [str(error)]
        self._problems += [f"{kind} '{name}': {line}" for line in lines]
        self._cause = self._cause or error

  def _report(self, collected: list[str] | None = None) -> None:
    """Raise the mistakes that were noted, or add them to a list."""
    lines, cause = [f"{self.label}: {problem}" for problem in self._problems], self._cause
    self._problems, self._cause = [], None
    if collected is not None:
      collected += lines
    elif lines:
      raise ConfigError(*lines) from cause

  @contextmanager
  def _undone(self, obj: Any) -> Generator[None]:
    """Restore the state of an object and the generator after a trial."""
    generator = self.env.rng.get_state()
    state = obj.state_dict() if isinstance(obj, Stateful) else None
    try:
      yield
    finally:
      self.env.rng.set_state(generator)
      if state is not None:
        obj.restore(state)

  @contextmanager
  def _trial(self, term: ManagerTermBase) -> Generator[None]:
    """Refuse writes to undeclared tensors of a term, and undo all others."""
    with self._undone(self), placed("in a trial call"), only_declared(term):
      yield

  def _tried(self, term: Term, *worlds: torch.Tensor) -> Any:
    """Return the value of a trial call, and undo its writes to state."""
    with self._undone(term.func):
      value = term.try_call(*worlds)
      if isinstance(term.func, ManagerTermBase) and not self.masked:
        with placed("in a trial call"), only_declared(term.func):
          term.func.reset(self._everywhere)
    return value

  def _misfit(self, value: Any, what: str, fits: Callable[[torch.Tensor], bool]) -> str:
    """Return the message about a value that is not a tensor on the device that fits; empty if it is one."""
    if isinstance(value, torch.Tensor) and value.device.type == self.device.type and fits(value):
      return ""
    return f"must return {what} on {self.device}, returned {described(value)}."

  def _with_ids(self, term: Term, mask: torch.Tensor, act: Callable[[torch.Tensor], object]) -> None:
    """Call `act` with the indices of the worlds in `mask` outside the recorded step, if there are any."""
    term.worlds.copy_(mask)

    def call() -> None:
      ids = term.worlds.nonzero().flatten()
      if ids.numel() > 0:
        act(ids)

    self.env.run_eagerly(call, name=f"{self.label.removesuffix('Manager').lower()} '{term.name}'")
