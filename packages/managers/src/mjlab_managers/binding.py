"""Binding of terms to their parameters: checks at build, the call in the step, and live changes."""

from __future__ import annotations

import copy
import dataclasses
import functools
import inspect
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, TypeVar, cast

import torch
from mjlab_core import ConfigError, MjlabError, check_name, field_problems, require

from mjlab_managers.env import ManagerEnv
from mjlab_managers.locked import LockedDict
from mjlab_managers.parameters import Scalar, Signature, fits_scalar, write_scalar
from mjlab_managers.scene_entity import resolve_entities
from mjlab_managers.term import ManagerTermBase, ManagerTermBaseCfg
from mjlab_managers.watch import Watch

T = TypeVar("T")

_WORLDS = ("mask", "env_ids")


class Term:
  """Term bound to its parameters: `term()`, or `term(mask)` if it acts on some worlds.

  Parameters annotated `float` are passed as scalars on the device, so that a change is a write. A term that reads them
  on the host gets Python numbers instead.

  Args:
    name: name of the term in its manager.
    owner: label of the manager, for messages.
    cfg: the manager's own copy.
    env: the environment.
    masked: the term acts on some worlds.

  Raises:
    MjlabError: a parameter names something that does not exist, or the class refuses its parameters.
  """

  def __init__(self, name: str, owner: str, cfg: ManagerTermBaseCfg, env: ManagerEnv, *, masked: bool = False) -> None:
    self.name, self.owner, self.cfg, self._env = name, owner, cfg, env
    self._kind = cast("type[ManagerTermBase]", cfg.func) if isinstance(cfg.func, type) else None
    self._signature = Signature(cfg.func, 2 if masked and self._kind is None else 1)
    called = self._signature if self._kind is None else Signature(self._kind.__call__, 2)
    self.wants_ids = masked and "env_ids" in called.leading
    # Terms with indices run outside the recorded step, where Python numbers serve. A function gets scalars once a trial
    # call shows that it can work with them.
    self._takes_scalars = self._kind is not None and not self.wants_ids
    self._is_tried = False
    self.given: dict[str, Any] = {}
    """Parameters, defaults included, with resolved entities."""
    self._scalars: dict[str, Scalar] = {}
    self._values: dict[str, Any] = {}
    self._used: set[str] = set()
    self._instance: ManagerTermBase | None = None
    self.func: Callable[..., Any] = cfg.func
    """The function, or the instance of the class."""
    self._build(self._resolved({**self._signature.defaults, **cfg.params}))

  def __call__(self, *args: Any) -> Any:
    try:
      return self.call(*args)
    except Exception as error:
      raise MjlabError(f"{self.owner}: term '{self.name}': {type(error).__name__}: {error}") from error

  def call(self, *args: Any) -> Any:
    """Call the term and pass its errors through."""
    if self._kind is not None:
      return self.func(*args)
    return self.func(self._env, *args, **self._values)

  def try_call(self, *args: Any, rebuilt: Callable[[], None]) -> Any:
    """Call the term on trial, with scalars if it works with them, otherwise with Python numbers."""
    if self._kind is None and not self.wants_ids and not self._is_tried:
      self._is_tried = self._takes_scalars = True
      self._build(self.given)
    with Watch() as watch:
      try:
        value, failed = self.call(*args), False
      except Exception:
        if not self._scalars:
          raise
        value, failed = None, True
    if not (self._scalars and (failed or watch.reads_host)):
      return value
    self._takes_scalars = False
    self._build(self.given)
    rebuilt()
    return self.call(*args)

  def set_params(self, params: Mapping[str, Any]) -> Callable[[], None] | None:
    """Change parameters, and return a function that undoes the change, or None if only scalars were written.

    Raises:
      MjlabError: a parameter does not exist or has a wrong value; nothing was changed.
    """
    if problems := list(self._signature.problems(params, complete=False)):
      raise ConfigError(*problems)
    resolved = self._resolved(params)
    changed = {name: value for name, value in resolved.items() if not same(value, self.given.get(name))}
    if all(
      name in self._scalars and name not in self._used and fits_scalar(self._scalars[name], value)
      for name, value in changed.items()
    ):
      for name, value in changed.items():
        write_scalar(self._scalars[name], value)
      self.given |= changed
      self._publish()
      return None
    before = self.given, self._scalars, self._values, self._used, self._takes_scalars
    attributes, state = self._remembered()

    def undo() -> None:
      self.given, self._scalars, self._values, self._used, self._takes_scalars = before
      if attributes is not None:
        vars(self._instance).clear()
        vars(self._instance).update(attributes)
      self._publish()

    try:
      self._build({**self.given, **changed})
      if state is not None and self._instance is not None:
        _carry_over(self._instance, state)
    except Exception:
      undo()
      raise
    return undo

  def scalar(self, name: str) -> torch.Tensor:
    """Return the scalar of a parameter on the device.

    Raises:
      MjlabError: no such parameter, or the term reads it only in `__init__`.
    """
    scalar = self._scalars.get(check_name("parameter", name, self.given))
    fixed = f"parameter '{name}' is not read again in every step, or is no number; set_params changes it between steps."
    return require(None if name in self._used else scalar, torch.Tensor, fixed)

  def _remembered(self) -> tuple[dict[str, Any] | None, dict[str, Any] | None]:
    if self._instance is None:
      return None, None
    return dict(vars(self._instance)), self._instance.state_dict()

  def _resolved(self, params: Mapping[str, Any]) -> dict[str, Any]:
    values = {}
    for name, value in params.items():
      try:
        values[name] = resolve_entities(value, self._env)
      except ValueError as error:
        raise MjlabError(f"parameter '{name}': {error}") from error
    return values

  def _build(self, given: dict[str, Any]) -> None:
    """Pass parameters to the term: keep them for the call of a function, or make the instance of a class."""
    scalars: dict[str, Scalar] = {}
    if self._takes_scalars:
      found = {name: self._signature.scalar(name, value, self._env.device) for name, value in given.items()}
      scalars = {name: scalar for name, scalar in found.items() if scalar is not None}
    values = {**given, **scalars}
    used: set[str] = set()
    if self._kind is not None:
      try:
        used = self._make(self._kind, values, scalars)
      except Exception:
        if not scalars:
          raise
        # It may need Python numbers; if not, the error is the same again.
        self._takes_scalars = False
        self._build(given)
        return
    self.given, self._scalars, self._values, self._used = given, scalars, values, used
    self._publish()

  def _make(self, kind: type[ManagerTermBase], values: dict[str, Any], scalars: dict[str, Scalar]) -> set[str]:
    """Run `__init__`, on the same object if there is one, and return the names of the scalars that it used."""
    term = kind.__new__(kind) if self._instance is None else self._instance
    vars(term).clear()
    term.name = self.name
    with Watch(scalars) as watch:
      kind.__init__(term, self._env, **values)
    self._instance = term
    self.func = cast("Callable[..., Any]", term)
    return watch.used

  def _publish(self) -> None:
    """Write the parameters into the config as a read-only dict."""
    advice = (
      f"{self.owner}: term '{self.name}' is built; change its parameters by set_params('{self.name}', name=value)."
    )
    vars(self.cfg)["params"] = LockedDict(self.given, advice)
    vars(self.cfg)["func"] = self.func


def call_terms(terms: Sequence[Term]) -> list[torch.Tensor]:
  """Return the values of terms, one after the other."""
  return [term() for term in terms]


def cfg_problems(name: str, cfg: Any, kind: type, base: type = ManagerTermBase, *, masked: bool = False) -> list[str]:
  """Return the mistakes in one config that show without an environment; `name` begins each line.

  Args:
    name: the config, such as "term 'upright'".
    cfg: the config.
    kind: its required class.
    base: required base of class terms.
    masked: terms act on some worlds.
  """
  if not isinstance(cfg, kind):
    return [f"{name}: expected a {kind.__name__}, got {described(cfg)}."]
  problems = field_problems(cfg)
  if isinstance(cfg, ManagerTermBaseCfg) and isinstance(cfg.params, dict):
    problems += term_problems(cfg, base, masked=masked)
  return [f"{name}: {problem}" for problem in problems]


def described(value: Any) -> str:
  """Return a description of a value for messages; for a tensor its type, shape and device."""
  if isinstance(value, torch.Tensor):
    return f"{str(value.dtype).removeprefix('torch.')} {tuple(value.shape)} on {value.device}"
  return f"{type(value).__name__} {value!r}" if isinstance(value, int | float | str) else type(value).__name__


def term_problems(cfg: ManagerTermBaseCfg, base: type = ManagerTermBase, *, masked: bool = False) -> list[str]:
  """Return the mistakes in a term and its parameters that show in signatures.

  Args:
    cfg: the term.
    base: required base of class terms.
    masked: the term acts on some worlds.
  """
  func = cfg.func
  if not callable(func):
    return [f"func {func!r} is not callable."]
  if isinstance(func, type):
    wrong = _class_problem(func, base, masked=masked)
    return [wrong] if wrong else list(Signature(func, 1).problems(cfg.params))
  if base is not ManagerTermBase:
    return [f"func must be a subclass of {base.__name__}, is {func!r}."]
  signature = Signature(func, 2 if masked else 1)
  if wrong := _leading_problem(signature, masked=masked):
    return [wrong]
  return list(signature.problems(cfg.params))


def _leading_problem(signature: Signature, *, masked: bool) -> str:
  if not signature.known:
    return ""
  if not signature.leading and not signature.takes_more_positional:
    return "must take the environment as its first parameter."
  if not masked:
    return ""
  second = signature.leading[1] if len(signature.leading) > 1 else ""
  if second in _WORLDS or (not second and signature.takes_more_positional):
    return ""
  found = f"'{second}'" if second else "missing"
  return (
    "the second parameter must be 'mask' (bool (num_envs,), recorded with the step) or 'env_ids' (indices, run outside "
    f"the recording); it is {found}."
  )


def _class_problem(kind: type, base: type, *, masked: bool) -> str:
  """Return the reason why a class cannot be a term; empty if it can."""
  name, is_called = kind.__name__, base is ManagerTermBase
  called = kind.__call__ if is_called and _defines(kind, "__call__") else None
  parameters = _names(called) if called else []
  worlds = parameters[0] if masked and parameters and parameters[0] in _WORLDS else "mask" if masked else ""
  resets = _names(getattr(kind, "reset", None))
  is_old = (
    _names(kind.__init__)[:1] not in (["env"], ["args"])
    or parameters not in ([worlds] if worlds else [], ["args"])
    or resets not in ([], ["mask"])
  )
  if is_called and called is not None and (is_old or not issubclass(kind, base)):
    wanted = [parameter for parameter in parameters if parameter not in ("env", *_WORLDS)]
    wanted = wanted or [parameter for parameter in _names(kind.__init__) if parameter not in ("env", "cfg")]
    signature = f"self, env, *, {', '.join(wanted)}" if wanted else "self, env"
    return (
      f"class {name} does not have the form of a class term, which takes its parameters in __init__:\n"
      f"  class {name}(ManagerTermBase):\n"
      f"    def __init__({signature}): super().__init__(env); ...\n"
      f"    def __call__(self{', ' + worlds if worlds else ''}): ...\n"
      "    def reset(self, mask): ...  # mask: bool (num_envs,); only where refilling its declared state is not enough"
    )
  if not issubclass(kind, base):
    return f"class {name} must be a subclass of {base.__name__}" + (" and have __call__." if is_called else ".")
  if is_called and called is None:
    return f"class {name} has no __call__."
  return f"class {name} must have the form __init__(self, env, *, ...)." if is_old else ""


def _defines(kind: type, name: str) -> bool:
  return any(name in vars(base) for base in kind.__mro__)


def _names(func: Any) -> list[str]:
  """Return the names of the parameters of a method, without `self`."""
  try:
    return list(inspect.signature(func).parameters)[1:]
  except (TypeError, ValueError):
    return []


def _carry_over(term: ManagerTermBase, state: Mapping[str, Any]) -> None:
  """Restore the state of a term that was built again, if it still fits."""
  try:
    term.load_state_dict(state)
  except MjlabError:
    # Another parameter, another shape: its state begins again.
    return


def copy_cfg(cfg: T) -> T:
  """Return a deep copy of a config. The owner of a bound method is not copied."""
  memo: dict[int, Any] = {}
  for func in _callables(cfg):
    if isinstance(func, types.MethodType):
      memo[id(func.__self__)] = func.__self__
    elif isinstance(func, ManagerTermBase):
      # The instance belongs to another environment.
      memo[id(func)] = type(func)
  return copy.deepcopy(cfg, memo)


def _callables(cfg: Any) -> Iterator[Any]:
  if isinstance(cfg, ManagerTermBaseCfg):
    yield cfg.func
  for term in (getattr(cfg, "terms", None) or {}).values():
    yield getattr(term, "func", None)


def attribute_of(func: Any, name: str, default: Any = None) -> Any:
  """Return the attribute `name` of a callable, or of the function inside partials and `functools.wraps`."""
  while True:
    if hasattr(func, name):
      return getattr(func, name)
    inner = func.func if isinstance(func, functools.partial) else getattr(func, "__wrapped__", None)
    if inner is None:
      return default
    func = inner


def same(a: Any, b: Any) -> bool:
  """Return True if two resolved parameter values, or two functions, are surely interchangeable."""
  if a is b:
    return True
  if type(a) is not type(b) or isinstance(a, torch.Tensor):
    return False
  if isinstance(a, Mapping):
    return list(a) == list(b) and all(same(a[key], b[key]) for key in a)
  if isinstance(a, functools.partial):
    return same(a.func, b.func) and same(a.args, b.args) and same(a.keywords, b.keywords)
  if isinstance(a, list | tuple):
    return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
  if dataclasses.is_dataclass(a):
    return all(same(getattr(a, item.name), getattr(b, item.name)) for item in dataclasses.fields(a))
  try:
    return bool(a == b)
  except (RuntimeError, TypeError, ValueError):
    return False
