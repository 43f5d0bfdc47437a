"""Base of all managers: named terms, trial calls at build, state, and live changes."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

import torch
from mjlab_core import ConfigError, MjlabError, Stateful, StatefulDict, UnknownNameError, unknown
from mjlab_core.errors import as_consequence, is_consequence

from mjlab_managers.binding import Term, call_terms, cfg_problems, copy_cfg, described
from mjlab_managers.env import ManagerEnv
from mjlab_managers.locked import lock
from mjlab_managers.term import ManagerTermBase, ManagerTermBaseCfg
from mjlab_managers.watch import undeclared_memory

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

  cfg_type: ClassVar[type]
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
    self._stateful_terms: StatefulDict[Stateful] = StatefulDict()
    self._resets: dict[str, Callable[[torch.Tensor], Any]] = {}
    self._bound: dict[str, Term] = {}
    self._problems: list[str] = []
    self._collected = problems
    self._cause: BaseException | None = None
    self._broken: set[str] = set()
    self._cfgs: dict[str, CfgT] = {}
    self._live: list[tuple[Any, frozenset[str]]] = []
    # Masks of the terms that take indices, read outside the recorded step.
    self._id_masks: dict[str, torch.Tensor] = {}
    for name, cfg in cfgs.items():
      if cfg is not None:
        self._read(name, cfg)
    self._make()
    self._raise_problems()
    self._collected = None
    self._seal()

  @classmethod
  def check(cls, cfgs: Mapping[str, CfgT | None]) -> list[str]:
    """Return the mistakes in configs that show without an environment, one line each."""
    given = [(name, cfg) for name, cfg in cfgs.items() if cfg is not None]
    return [f"{cls.__name__}: {problem}" for name, cfg in given for problem in cls._cfg_problems(name, cfg)]

  @classmethod
  def _cfg_problems(cls, name: str, cfg: CfgT) -> Iterator[str]:
    """Yield the mistakes in one config that show without an environment."""
    yield from cfg_problems(f"term '{name}'", cfg, cls.cfg_type, cls.term_base, masked=cls.masked)

  # Interface for users.

  @property
  def label(self) -> str:
    """Name of the manager in messages."""
    return type(self).__name__

  @property
  def active_terms(self) -> Any:
    """Names of the terms in order."""
    return list(self._cfgs)

  def get_term_cfg(self, name: str, /) -> CfgT:
    """Return the config of a term. It is read-only except for `live_fields`; `set_params` changes parameters.

    Raises:
      UnknownNameError: no such term.
    """
    return self._lookup(self._cfgs, name)

  def term(self, name: str, /) -> Term:
    """Return a term as a callable with its parameters: `term()`, or `term(mask)` for events and curricula.

    Raises:
      UnknownNameError: no such term.
    """
    return self._lookup(self._bound, name)

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
    term = self._lookup(self._bound, name)
    with self._naming(name):
      undo = term.set_params(params)
    if undo is None:
      return
    if not self._check_again(term):
      undo()
    self._adopt(name, term.func)
    self._raise_problems()
    if not term.wants_ids:
      self.env.request_recapture(f"{self.label}: parameters of '{name}' changed")

  def scalar(self, name: str, parameter: str, /) -> torch.Tensor:
    """Return a scalar parameter of a term, float64, 0-d, that curricula may write inside the step.

    The config of the term does not show such writes.

    Raises:
      UnknownNameError: no such term.
      MjlabError: no such parameter, or the term does not read it in every step.
    """
    term = self._lookup(self._bound, name)
    with self._naming(name):
      return term.scalar(parameter)

  def describe(self) -> str:
    """Return a table of the terms."""
    return ""

  def terms(self, env_idx: int) -> list[tuple[str, list[float]]]:
    """Return name and current values of each term in one world, for viewers. It reads from the device."""
    del env_idx
    return []

  # Interface for the environment.

  def rehearse(self) -> None:
    """Call every term that was not called at build once for all worlds, and report errors like mistakes in configs.

    The state of terms is restored. The environment restores the simulation, the scene and the generator.
    """

  def remember(self) -> Callable[[], None]:
    """Return a function that restores the present parameters, live fields of configs, and state."""
    state = self.state_dict()
    given = {name: dict(term.given) for name, term in self._bound.items()}
    fields = [(cfg, {name: getattr(cfg, name) for name in live}) for cfg, live in self._live]

    def put_back() -> None:
      for name, params in given.items():
        now = self._bound[name].given
        if changed := {key: value for key, value in params.items() if now[key] is not value}:
          self.set_params(name, **changed)
      for cfg, values in fields:
        for name, value in values.items():
          setattr(cfg, name, value)
      self.restore(state)

    return put_back

  def reset(self, mask: torch.Tensor) -> None:
    """End the episodes of the worlds in `mask`, bool (N,): log their statistics and reset their state."""
    for name, reset in self._resets.items():
      with self._naming(name):
        reset(mask)

  def sync(self) -> None:
    """Read changes of live fields, on the host before each step, and request a new recording if needed."""

  def log_tensors(self) -> tuple[list[str], torch.Tensor]:
    """Return log keys and values since `clear_log`, float64 (K,) on the device; NaN if nothing happened."""
    return [], torch.zeros(0, dtype=torch.float64, device=self.device)

  def clear_log(self) -> None:
    """Begin a new log interval."""

  # Interface for subclasses.

  def _make(self) -> None:
    """Make the terms of the configs, which are read by now; note the mistakes."""

  def _read(self, name: str, cfg: CfgT) -> None:
    """Keep a copy of a config without mistakes; note the mistakes otherwise."""
    if found := list(self._cfg_problems(name, cfg)):
      self._broken.add(name)
      for problem in found:
        self._problem(problem)
    else:
      self._cfgs[name] = copy_cfg(cfg)

  def _lookup(self, table: Mapping[str, Any], name: str) -> Any:
    if name in table:
      return table[name]
    error = UnknownNameError(unknown("term", name, list(table), owner=self.label))
    if name in self._broken:
      raise as_consequence(error)
    raise error

  @contextmanager
  def _naming(self, name: str) -> Generator[None]:
    """Add the names of manager and term to an error."""
    try:
      yield
    except Exception as error:
      raise self._named(name, error) from error

  def _named(self, name: str, error: Exception) -> MjlabError:
    kind = "" if isinstance(error, MjlabError) else f"{type(error).__name__}: "
    return MjlabError(f"{self.label}: term '{name}': {kind}{error}")

  @contextmanager
  def _noting(self, name: str, what: str) -> Generator[None]:
    """Note an error as a mistake of a term; `what` tells when it occurred, such as "in a trial call"."""
    try:
      yield
    except Exception as error:
      kind = "" if isinstance(error, MjlabError) else f"{type(error).__name__} {what}{place_of(error)}: "
      self._problem(f"term '{name}': {kind}{error}", error)

  def _problem(self, text: str, cause: BaseException | None = None) -> None:
    if not is_consequence(cause):
      self._problems.append(text)
      self._cause = self._cause or cause

  def _raise_problems(self) -> None:
    """Report the mistakes so far: raise them, or add them to the list passed to the manager."""
    if not self._problems:
      return
    lines, cause = [f"{self.label}: {problem}" for problem in self._problems], self._cause
    self._problems, self._cause = [], None
    if self._collected is None:
      raise ConfigError(*lines) from cause
    self._collected += lines

  def _seal(self) -> None:
    """Make the configs read-only."""
    for name, cfg in self._cfgs.items():
      self._lock(name, cfg, self.live_fields)

  def _lock(self, name: str, cfg: Any, live: frozenset[str]) -> None:
    ways = [f"set_params('{name}', ...) changes its parameters"] if isinstance(cfg, ManagerTermBaseCfg) else []
    ways += [f"these fields may be assigned: {', '.join(sorted(live))}"] if live else []
    advice = f"{self.label}: '{name}' is built, and its config is read-only"
    lock(cfg, "; ".join([advice, *ways]) + ".", live)
    self._live.append((cfg, live))

  def _drop(self, name: str) -> None:
    """Remove a term that has a mistake."""
    self._broken.add(name)
    self._cfgs.pop(name, None)
    self._bound.pop(name, None)
    self._resets.pop(name, None)
    self._stateful_terms.pop(name, None)

  def _bind(self, name: str, cfg: ManagerTermBaseCfg) -> Term | None:
    """Return the term with its parameters, or None with the mistake noted."""
    with self._noting(name, "while making it"):
      term = Term(name, self.label, cfg, self.env, masked=self.masked)
      self._adopt(name, term.func)
      self._bound[name] = term
      if term.wants_ids:
        self._id_masks[name] = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)
      return term
    return None

  def _adopt(self, name: str, obj: Any) -> None:
    """Register a term for saving and for resets."""
    if isinstance(obj, Stateful):
      self._stateful_terms[name] = obj
      obj.state_dict()
    if not isinstance(obj, type) and callable(reset := getattr(obj, "reset", None)):
      self._resets[name] = reset

  def _build(self, name: str, cfg: Any) -> Any:
    """Return `cfg.build(env)`, or None with the mistake noted."""
    with self._noting(name, "while making it"):
      obj = cfg.build(self.env)
      obj.name = name
      self._adopt(name, obj)
      return obj
    return None

  def _with_ids(self, name: str, mask: torch.Tensor, act: Callable[[torch.Tensor], object]) -> None:
    """Call `act` with the indices of the worlds in `mask` outside the recorded step, if there are any."""
    kept = self._id_masks[name]
    kept.copy_(mask)

    def call() -> None:
      ids = kept.nonzero().flatten()
      if ids.numel() > 0:
        act(ids)

    self.env.run_eagerly(call, name=f"{self.label.removesuffix('Manager').lower()} '{name}'")

  @contextmanager
  def _trial(self, name: str, obj: Any, what: str = "a trial call") -> Generator[Trial]:
    """Note errors of a trial and its writes to undeclared tensors; restore state and the generator."""
    trial, generator = Trial(obj), self.env.rng.get_state()
    state = obj.state_dict() if isinstance(obj, Stateful) else None
    trial.failed = True
    with self._noting(name, f"in {what}"):
      yield trial
      trial.failed = False
    self.env.rng.set_state(generator)
    before, after = trial.memory, undeclared_memory(obj)
    way = "Declare state in __init__, self.x = self.state(...), and write into it: copy_, mul_, where_."
    moved = [path for path, (address, _) in after.items() if path not in before or before[path][0] != address]
    written = [] if moved else [path for path, memory in after.items() if before[path] != memory]
    if moved:
      self._problem(
        f"term '{name}': {what} put another tensor into {', '.join(moved)}, which a recorded step cannot follow. {way}"
      )
    if written:
      self._problem(
        f"term '{name}': {what} wrote into {', '.join(written)}, which is not declared, so it is not saved with a run. "
        f"{way}"
      )
    trial.failed = trial.failed or bool(moved or written)
    if isinstance(obj, Stateful) and state is not None:
      obj.restore(state)

  def _check_again(self, term: Term) -> bool:
    """Return True if a term works after a build or rebuild; note the mistakes otherwise."""
    del term
    return True

  def _check_tensor(self, name: str, value: Any, what: str, fits: Callable[[torch.Tensor], bool]) -> bool:
    """Return True for a tensor on the device that fits; note the mistake otherwise."""
    if isinstance(value, torch.Tensor) and value.device.type == self.device.type and fits(value):
      return True
    self._problem(f"term '{name}': must return {what} on {self.device}, returned {described(value)}.")
    return False


class Trial:
  """Result of a trial call, and the undeclared memory of the object before it."""

  def __init__(self, obj: Any) -> None:
    self.value: Any = None
    self.failed = False
    self._obj = obj
    self.rebuilt()

  def rebuilt(self) -> None:
    """Take the memory again, because the object was built again."""
    self.memory = undeclared_memory(self._obj)


def place_of(error: Exception) -> str:
  """Return the place in a term, or in a function that it called, of an error: " (my_terms.py, line 12)"."""
  here = Path(__file__).parent
  # The first frame is where it was caught.
  for frame in traceback.extract_tb(error.__traceback__)[1:]:
    path = Path(frame.filename)
    if path.parent != here and "torch" not in path.parts:
      return f" ({path.name}, line {frame.lineno})"
  return ""
