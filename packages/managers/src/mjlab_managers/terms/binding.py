"""Binding of terms to their parameters: checks at build, trial calls, the call in the step, and live changes."""

from __future__ import annotations

import functools
import inspect
import traceback
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import torch
from mjlab_core import ConfigError, MjlabError, check_name, field_problems, require
from mjlab_core.config import write_locked

from mjlab_managers.env import ManagerEnv
from mjlab_managers.terms.parameters import Signature, is_number
from mjlab_managers.terms.scene_entity import resolve_entities
from mjlab_managers.terms.term import ManagerTermBase, ManagerTermBaseCfg
from mjlab_managers.terms.watch import Watch, only_declared


class Term:
  """Term bound to its parameters: `term()`, or `term(mask)` if it acts on some worlds.

  Parameters annotated `float` are passed as scalars on the device, so that a change is a write. A term that reads them
  on the host gets Python numbers instead.

  Args:
    name: name of the term in its manager.
    owner: label of the manager, for messages.
    cfg: the read-only config, which shows the instance of a class and the present parameters.
    params: parameters by name.
    env: the environment.
    masked: the term acts on some worlds.

  Raises:
    MjlabError: a parameter names something that does not exist, or the class refuses its parameters.
  """

  def __init__(
    self, name: str, owner: str, cfg: ManagerTermBaseCfg, params: dict[str, Any], env: ManagerEnv, *, masked: bool
  ) -> None:
    self.name, self.owner, self.cfg, self._env = name, owner, cfg, env
    self._kind: Any = cfg.func if isinstance(cfg.func, type) else None
    self._signature = Signature(cfg.func, masked=masked)
    leading = self._signature.leading if self._kind is None else _names(self._kind.__call__)
    self.wants_ids = masked and "env_ids" in leading
    self.worlds = torch.zeros(env.num_envs, dtype=torch.bool, device=env.device)
    """Worlds to act on, for terms that take indices outside the recorded step, bool (num_envs,)."""
    # Terms with indices run outside the recorded step, where Python numbers serve. A function gets scalars once a trial
    # call shows that it can work with them.
    self._takes_scalars = self._kind is not None and not self.wants_ids
    self._is_tried = self.wants_ids or self._kind is not None
    self.given: dict[str, Any] = {}
    """Parameters, defaults included, with resolved entities."""
    self._values: dict[str, Any] = {}
    self._scalars: dict[str, torch.Tensor] = {}
    self.is_written = False
    """True if a scalar was given out, so that the present value may be another than in `given`."""
    self.func: Any = cfg.func
    """The function, or the instance of the class."""
    self._build(self._resolved({**self._signature.defaults, **params}))

  def __call__(self, *args: Any) -> Any:
    return call_named(self.owner, self.name, self._call, *args)

  def _call(self, *args: Any) -> Any:
    if self._kind is not None:
      return self.func(*args)
    return self.func(self._env, *args, **self._values)

  def try_call(self, *args: Any) -> Any:
    """Call the term on trial, with scalars if it works with them, otherwise with Python numbers.

    Raises:
      MjlabError: the call failed, or wrote to undeclared memory.
    """
    if not self._is_tried:
      self._is_tried = self._takes_scalars = True
      self._build(self.given)
    has_scalars = any(self._values[name] is not value for name, value in self.given.items())
    try:
      with Watch() as watch, placed("in a trial call"), only_declared(self.func):
        value = self._call(*args)
      if not (has_scalars and watch.reads_host):
        return value
    except MjlabError:
      if not has_scalars:
        raise
    self._takes_scalars = False
    self._build(self.given)
    return self.try_call(*args)

  def snapshot(self) -> Callable[[], None]:
    """Return a function that undoes later changes of parameters."""
    attributes = [(obj, dict(vars(obj))) for obj in (self, self.func) if obj is self or self._kind is not None]
    values = self.scalar_values()

    def undo() -> None:
      for obj, before in attributes:
        vars(obj).clear()
        vars(obj).update(before)
      self.write_scalars(values)
      self._show(self.given)

    return undo

  def set_params(self, params: Mapping[str, Any]) -> bool:
    """Change parameters, and return True if the term was built again, False if only scalars were written.

    Raises:
      MjlabError: a parameter does not exist or has a wrong value.
    """
    if problems := self.problems(params):
      raise ConfigError(*problems)
    changed = {
      name: value
      for name, value in self._resolved(params).items()
      if name in self._scalars or not same(value, self.given.get(name))
    }
    if all(name in self._scalars and _is_scalar(value) for name, value in changed.items()):
      for name, value in changed.items():
        self._scalars[name].fill_(value)
      self._show({**self.given, **changed})
      return False
    state = self.func.state_dict() if self._kind is not None else {}
    self._build({**self.given, **changed}, changed)
    if self._kind is not None:
      # Another parameter may change a shape. Then the state begins with its initial values.
      with suppress(MjlabError):
        self.func.load_state_dict(state)
    return True

  def problems(self, params: Mapping[str, Any]) -> list[str]:
    """Return the mistakes in changed parameters: unknown names and wrong values."""
    return list(self._signature.problems(params, complete=False))

  def scalar(self, name: str) -> torch.Tensor:
    """Return the scalar of a parameter on the device.

    Raises:
      MjlabError: no such parameter, or the term reads it only in `__init__`.
    """
    fixed = f"parameter '{name}' is not read again in every step, or is not a number; use set_params between steps."
    value = require(self._scalars.get(check_name("parameter", name, self.given)), torch.Tensor, fixed)
    self.is_written = True
    return value

  def scalar_values(self) -> dict[str, torch.Tensor]:
    """Return copies of the scalars on the device."""
    return {name: scalar.clone() for name, scalar in self._scalars.items()}

  def write_scalars(self, values: Mapping[str, torch.Tensor]) -> None:
    """Write values from `scalar_values` back."""
    for name in self._scalars.keys() & values.keys():
      self._scalars[name].copy_(values[name])

  def _resolved(self, params: Mapping[str, Any]) -> dict[str, Any]:
    values = {}
    for name, value in params.items():
      try:
        values[name] = resolve_entities(value, self._env)
      except ValueError as error:
        raise MjlabError(f"parameter '{name}': {error}") from error
    return values

  def _build(self, given: dict[str, Any], changed: Iterable[str] = ()) -> None:
    """Pass parameters to the term: keep them for the call of a function, or make the instance of a class.

    Scalars stay in their memory, which curricula may hold; only those in `changed` are written.
    """
    scalars = self._signature.scalars(given, self._env.device) if self._takes_scalars else {}
    for name in scalars.keys() & self._scalars.keys():
      kept = self._scalars[name]
      if name in changed:
        kept.copy_(scalars[name])
      scalars[name] = kept
    values = {**given, **scalars}
    used: set[str] = set()
    if self._kind is not None:
      try:
        used = self._make(values, scalars)
      except MjlabError:
        if not scalars:
          raise
        # It may need Python numbers. Otherwise the second try gives the same error.
        self._takes_scalars = False
        self._build(given)
        return
    self._values = values
    self._scalars = {name: scalar for name, scalar in scalars.items() if name not in used}
    self._show(given)

  def _make(self, values: dict[str, Any], scalars: dict[str, torch.Tensor]) -> set[str]:
    """Run `__init__`, on the same object if there is one, and return the names of the scalars that it used."""
    term = self._kind.__new__(self._kind) if self.func is self._kind else self.func
    vars(term).clear()
    term.name = self.name
    with Watch(scalars) as watch, placed("while making it"):
      term.__init__(self._env, **values)
    self.func = term
    return watch.used

  def _show(self, given: dict[str, Any]) -> None:
    """Keep the present parameters, and show them in the config."""
    self.given = given
    write_locked(self.cfg, params=dict(given), func=self.func)


def call_terms(terms: Sequence[Term]) -> list[torch.Tensor]:
  """Return the values of terms, one after the other."""
  return [term() for term in terms]


def call_named(owner: str, name: str, function: Callable[..., Any], *args: Any) -> Any:
  """Call a function of a term in the step, and add the names of manager and term to its errors."""
  try:
    return function(*args)
  except Exception as error:
    raise named(owner, name, error) from error


def named(owner: str, name: str, error: Exception) -> MjlabError:
  """Return an error with the names of manager and term."""
  kind = "" if isinstance(error, MjlabError) else f"{type(error).__name__}: "
  return MjlabError(f"{owner}: term '{name}': {kind}{error}")


@contextmanager
def placed(what: str) -> Generator[None]:
  """Add type and place to errors of terms; `what` is the moment of the error, such as "in a trial call".

  Raises:
    MjlabError: an error inside.
  """
  try:
    yield
  except MjlabError:
    raise
  except Exception as error:
    raise MjlabError(f"{type(error).__name__} {what}{place_of(error)}: {error}") from error


def place_of(error: Exception) -> str:
  """Return the place in a term, or in a function that it called, of an error: " (my_terms.py, line 12)"."""
  here = Path(__file__).parents[1]
  # The first frame is where it was caught.
  for frame in traceback.extract_tb(error.__traceback__)[1:]:
    path = Path(frame.filename)
    if here not in path.parents and "torch" not in path.parts:
      return f" ({path.name}, line {frame.lineno})"
  return ""


def cfg_problems(cfg: Any, kind: type, base: type = ManagerTermBase, *, masked: bool = False) -> list[str]:
  """Return the mistakes in one config that show without an environment.

  Args:
    cfg: the config.
    kind: its required class.
    base: required base of class terms.
    masked: terms act on some worlds.
  """
  if not isinstance(cfg, kind):
    return [f"expected a {kind.__name__}, got {described(cfg)}."]
  problems = field_problems(cfg)
  if isinstance(cfg, ManagerTermBaseCfg) and isinstance(cfg.params, dict):
    wrong = _form_problem(cfg.func, base, masked=masked)
    problems += [wrong] if wrong else Signature(cfg.func, masked=masked).problems(cfg.params)
  return problems


def described(value: Any) -> str:
  """Return a description of a value for messages; for a tensor its type, shape and device."""
  if isinstance(value, torch.Tensor):
    return f"{str(value.dtype).removeprefix('torch.')} {tuple(value.shape)} on {value.device}"
  return f"{type(value).__name__} {value!r}" if isinstance(value, int | float | str) else type(value).__name__


def _form_problem(func: Any, base: type, *, masked: bool) -> str:
  """Return the reason why an object cannot be a term; empty if it can."""
  if not callable(func):
    return f"func {func!r} is not callable."
  if isinstance(func, type):
    return _class_problem(func, base, masked=masked)
  if hasattr(func, "reset"):
    return f"func is an object of {type(func).__name__}, and its reset would never be called; give the class."
  if base is not ManagerTermBase:
    return f"func must be a subclass of {base.__name__}, is {func!r}."
  signature = Signature(func, masked=masked)
  leading = signature.leading
  if not leading and not signature.takes_more_positional:
    return "must take the environment as its first parameter."
  if not masked or leading[1:2] in (["mask"], ["env_ids"]) or (signature.takes_more_positional and not leading[1:]):
    return ""
  return (
    "the second parameter must be 'mask' (bool (num_envs,), recorded with the step) or 'env_ids' (indices, run outside "
    f"the recording); it is {repr(leading[1]) if leading[1:] else 'missing'}."
  )


def _class_problem(kind: Any, base: type, *, masked: bool) -> str:
  """Return the form of class terms if a class has another one."""
  is_called = base is ManagerTermBase
  calls = (["mask"], ["env_ids"], ["args"]) if masked else ([], ["args"])
  if (
    issubclass(kind, base)
    and _names(kind.__init__)[:1] in (["env"], ["args"])
    and _names(kind.reset) == ["mask"]
    and (not is_called or ("__call__" in dir(kind) and _names(kind.__call__) in calls))
  ):
    return ""
  called = f"    def __call__(self{', mask' if masked else ''}): ...\n" if is_called else ""
  return (
    f"class {kind.__name__} does not have the form of a class term, which takes its parameters in __init__:\n"
    f"  class {kind.__name__}({base.__name__}):\n"
    f"    def __init__(self, env, *, ...): super().__init__(env); ...\n{called}"
    "    def reset(self, mask): ...  # mask: bool (num_envs,); only where refilling its declared state is not enough"
  )


def _is_scalar(value: Any) -> bool:
  return is_number(value) or (isinstance(value, torch.Tensor) and value.dim() == 0)


def mask_problem(term: ManagerTermBase) -> str:
  """Return the method of a command or action that takes world numbers, as in mjlab 1.x; empty if there is none."""
  for name in ("reset", "resample"):
    if hasattr(term, name) and "env_ids" in _names(getattr(type(term), name)):
      method = f"{type(term).__name__}.{name}"
      return f"{method}(self, env_ids) must be {name}(self, mask), with the worlds in `mask`, bool (num_envs,)."
  return ""


def _names(method: Callable[..., Any]) -> list[str]:
  """Return the names of the parameters of a method, without `self`."""
  return list(inspect.signature(method).parameters)[1:]


def attribute_of(func: Any, name: str, default: Any) -> Any:
  """Return the attribute `name` of a callable, or of the function inside partials."""
  while isinstance(func, functools.partial) and not hasattr(func, name):
    func = func.func
  return getattr(func, name, default)


def same(a: Any, b: Any) -> bool:
  """Return True if two resolved parameter values, or two functions, are surely interchangeable."""
  if a is b:
    return True
  if type(a) is not type(b) or isinstance(a, torch.Tensor):
    return False
  try:
    return bool(a == b)
  except (RuntimeError, TypeError, ValueError):
    return False
