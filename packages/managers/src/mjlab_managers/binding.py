"""Binding a term's parameters to its signature, at build, so that every mistake has a name."""

from __future__ import annotations

import copy
import dataclasses
import functools
import inspect
import operator
import types
from collections.abc import Callable, Iterator, Mapping
from typing import Any, TypeVar

import torch
from mjlab_core.names import UnknownNameError, nearest

from mjlab_managers.env import ManagerEnv
from mjlab_managers.scene_entity import SceneEntityCfg
from mjlab_managers.term import ManagerTermBaseCfg

T = TypeVar("T")

_POSITIONAL = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
_BY_NAME = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)


class Term:
  """A term ready to be called: `term()` or, for those that act on some worlds, `term(mask)`."""

  def __init__(
    self, name: str, cfg: ManagerTermBaseCfg, func: Callable[..., Any], env: ManagerEnv, *, wants_ids: bool
  ) -> None:
    self.name, self.cfg, self.func, self._env = name, cfg, func, env
    self.wants_ids = wants_ids
    self.seen = tuple(cfg.params.values())

  def __call__(self, *args: Any) -> Any:
    # The config's own dict, so that a change on the host takes effect.
    return self.func(self._env, *args, **self.cfg.params)

  def params_changed(self) -> bool:
    """Whether a parameter was replaced on the host since the last call; if so, its entities are resolved."""
    params = self.cfg.params
    if len(params) == len(self.seen) and all(map(operator.is_, params.values(), self.seen)):
      return False
    for key, value in self.cfg.params.items():
      self.cfg.params[key] = resolve_entities(value, self._env)
    self.seen = tuple(self.cfg.params.values())
    return True


def copy_cfg(cfg: T) -> T:
  """A deep copy of a config that leaves the owner of a bound method alone."""
  memo: dict[int, Any] = {}
  for func in _callables(cfg):
    if isinstance(func, types.MethodType):
      memo[id(func.__self__)] = func.__self__
  return copy.deepcopy(cfg, memo)


def _callables(cfg: Any) -> Iterator[Any]:
  if isinstance(cfg, ManagerTermBaseCfg):
    yield cfg.func
  for term in (getattr(cfg, "terms", None) or {}).values():
    yield getattr(term, "func", None)


def attribute_of(func: Any, name: str, default: Any = None) -> Any:
  """The attribute `name` of a callable, seen through partials and `functools.wraps`."""
  while True:
    if hasattr(func, name):
      return getattr(func, name)
    inner = func.func if isinstance(func, functools.partial) else getattr(func, "__wrapped__", None)
    if inner is None:
      return default
    func = inner


def resolve_entities(value: Any, env: ManagerEnv) -> Any:
  """`value` with every SceneEntityCfg in it resolved; containers are copied only where something in them changed."""
  if isinstance(value, SceneEntityCfg):
    return value if value.resolved else value.resolve(env.scene, env.device)
  if isinstance(value, dict):
    items = {key: resolve_entities(item, env) for key, item in value.items()}
    return value if all(items[key] is value[key] for key in items) else items
  if isinstance(value, list | tuple):
    parts = [resolve_entities(item, env) for item in value]
    if all(a is b for a, b in zip(parts, value, strict=True)):
      return value
    return type(value)(*parts) if hasattr(value, "_fields") else type(value)(parts)
  if dataclasses.is_dataclass(value) and not isinstance(value, type):
    changed = {}
    for item in dataclasses.fields(value):
      old = getattr(value, item.name)
      new = resolve_entities(old, env)
      if new is not old:
        changed[item.name] = new
    if not changed:
      return value
    twin = copy.copy(value)
    for name, new in changed.items():
      object.__setattr__(twin, name, new)
    return twin
  return value


def same(a: Any, b: Any) -> bool:
  """Whether two resolved parameter values, or two functions, are interchangeable; in doubt they are not."""
  if a is b:
    return True
  if type(a) is not type(b):
    return False
  if isinstance(a, torch.Tensor):
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


def bind(
  name: str, cfg: ManagerTermBaseCfg, env: ManagerEnv, problems: list[str], *, masked: bool = False
) -> Term | None:
  """Merges defaults and `cfg.params`, resolves entities, makes class terms; None if something is wrong.

  Args:
    name: the term's name, for messages.
    cfg: the manager's own copy; its `params` become complete, its `func` the instance of a class term.
    env: the environment.
    problems: receives one line per mistake.
    masked: the term takes `mask` or `env_ids` after the environment.
  """
  problem_count = len(problems)
  func = cfg.func
  if not callable(func):
    problems.append(f"term '{name}': func {func!r} is not callable.")
    return None
  if isinstance(func, type) and not any("__call__" in vars(base) for base in func.__mro__):
    problems.append(f"term '{name}': class {func.__name__} has no __call__.")
    return None
  second = ""
  if not isinstance(cfg.params, dict):
    problems.append(f"term '{name}': params must be a dict, got {cfg.params!r}.")
    return None
  merged = dict(cfg.params)
  parameters = _parameters(func)
  if parameters is not None:
    leading = [p for p in parameters if p.kind in _POSITIONAL][: 2 if masked else 1]
    starred = any(p.kind is inspect.Parameter.VAR_POSITIONAL for p in parameters)
    if masked:
      second = leading[1].name if len(leading) > 1 else ""
      if second not in ("mask", "env_ids") and not (starred and not second):
        found = f"'{second}'" if second else "missing"
        problems.append(
          f"term '{name}': the second parameter must be 'mask' (bool (num_envs,), recorded with the step) or 'env_ids' "
          f"(indices, run outside the recording); it is {found}."
        )
        return None
    elif not leading and not starred:
      problems.append(f"term '{name}': must take the environment as its first parameter.")
      return None
    open_ended = any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters)
    possible = {p.name: p for p in parameters if p.kind in _BY_NAME and p not in leading}
    for given in cfg.params:
      if given not in possible and not open_ended:
        problems.append(_unknown_parameter(name, given, list(cfg.params), list(possible)))
    missing = [p.name for p in possible.values() if p.default is p.empty and p.name not in cfg.params]
    if missing:
      problems.append(
        f"term '{name}': missing parameter{'s' * (len(missing) > 1)} {', '.join(missing)}. "
        f"Given: {_listed(cfg.params)}; possible: {_listed(possible)}."
      )
    defaults = {p.name: p.default for p in possible.values() if p.default is not p.empty and p.name not in cfg.params}
    merged = {**defaults, **merged}
  for key, value in merged.items():
    try:
      merged[key] = resolve_entities(value, env)
    except (ValueError, KeyError) as error:
      problems.append(f"term '{name}': parameter '{key}': {error.args[0] if error.args else error}")
  if len(problems) > problem_count:
    return None
  cfg.params = merged
  if isinstance(func, type):
    try:
      func = func(cfg, env)
    except (ValueError, UnknownNameError) as error:
      # Of the term itself, about what it was given.
      problems.append(f"term '{name}': {error}")
      return None
    except Exception as error:
      problems.append(f"term '{name}': {type(error).__name__} while making {func.__name__}: {error}")
      return None
    func.name = name
    cfg.func = func
  return Term(name, cfg, func, env, wants_ids=second == "env_ids")


def _parameters(func: Any) -> list[inspect.Parameter] | None:
  try:
    if isinstance(func, type):
      return list(inspect.signature(func.__call__).parameters.values())[1:]
    return list(inspect.signature(func).parameters.values())
  except (ValueError, TypeError):
    # Some built-ins have no signature; the dry run is then the only check.
    return None


def _listed(names: Any) -> str:
  return ", ".join(names) or "none"


def _unknown_parameter(term: str, given: str, all_given: list[str], possible: list[str]) -> str:
  close = nearest(given, possible)
  hint = f" Nearest: {', '.join(close)}." if close else ""
  return (
    f"term '{term}': unknown parameter '{given}'.{hint} Given: {_listed(all_given)}; possible: {_listed(possible)}."
  )
