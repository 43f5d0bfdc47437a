"""Constraints of config fields: declared in a field's annotation, and checked by one function.

    @dataclass(kw_only=True)
    class LidarCfg:
      mode: Literal["spin", "scan"] = "spin"
      rows: Annotated[int, Limits(ge=1)] = 16
      noise: NonNegative = 0.0
      fov: Annotated[tuple[float, float], Limits(ge=-90, le=90), Ascending()] = (-15.0, 15.0)
      offsets: Annotated[float | Mapping[str, float] | None, Limits(gt=0)] = None

      def __post_init__(self) -> None:
        check_fields(self, "LidarCfg")

An annotation is a constraint by itself where it is `int`, `float`, `str`, `bool`, a `Literal`, a tuple or mapping of
these, or a union. Limits apply to every number of a value: to all elements of a sequence and all values of a mapping.
Values of other types are accepted.
"""

from __future__ import annotations

import builtins
import math
import sys
import types
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import cache
from itertools import pairwise
from numbers import Integral, Real
from typing import Annotated, Any, Final, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from mjlab_core.errors import ConfigError
from mjlab_core.names import unknown

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Limits:
  """Limits of all numbers of a value, NaN refused.

  Args:
    ge: numbers are at least this.
    gt: numbers are greater than this.
    le: numbers are at most this.
    lt: numbers are less than this.
    finite: infinity is refused too.
    nonzero: zero is refused.
  """

  ge: float = -math.inf
  gt: float = -math.inf
  le: float = math.inf
  lt: float = math.inf
  finite: bool = True
  nonzero: bool = False

  def problem(self, value: Any) -> str:
    """Return the rule that a value breaks, to follow "must"; empty if it keeps all."""
    numbers = list(_numbers(value))
    if any(math.isnan(number) for number in numbers):
      return "be a number"
    if self.finite and any(math.isinf(number) for number in numbers):
      return "be finite"
    if self.nonzero and any(number == 0 for number in numbers):
      return "not be zero"
    inside = all(self.ge <= number <= self.le for number in numbers)
    # An infinite bound allows infinity.
    above = self.gt == -math.inf or all(number > self.gt for number in numbers)
    below = self.lt == math.inf or all(number < self.lt for number in numbers)
    return "" if inside and above and below else self._words

  @property
  def _words(self) -> str:
    low, high = max(self.ge, self.gt), min(self.le, self.lt)
    if math.isinf(high):
      if low == 0:
        return "be positive" if self.gt == 0 else "not be negative"
      return f"be above {low:g}" if self.gt == low else f"be at least {low:g}"
    if math.isinf(low):
      return f"be below {high:g}" if self.lt == high else f"be at most {high:g}"
    ends = ("(" if self.gt == low else "[") + f"{low:g}, {high:g}" + (")" if self.lt == high else "]")
    return f"be in {ends}"


@dataclass(frozen=True, kw_only=True)
class Ascending:
  """Order of a sequence: no element is less than the one before it, nor equal to it if `strict`."""

  strict: bool = False

  def problem(self, value: Any) -> str:
    """Return the rule that a value breaks, to follow "must"; empty if it keeps it, or is not a sequence."""
    if value is None or isinstance(value, str | Mapping | Real):
      return ""
    ordered = all(a < b if self.strict else a <= b for a, b in pairwise(value))
    return "" if ordered else ("rise" if self.strict else "not fall")


@dataclass(frozen=True, kw_only=True)
class Items:
  """Number of elements of a sequence or mapping, from `ge` to `le`; each occurs once if `unique`."""

  ge: int = 1
  le: int = sys.maxsize
  unique: bool = False

  def problem(self, value: Any) -> str:
    """Return the rule that a value breaks, to follow "must"; empty if it keeps it, or is None or a string."""
    if value is None or isinstance(value, str):
      return ""
    if not self.ge <= len(value) <= self.le:
      count, bound = (self.ge, "at least") if len(value) < self.ge else (self.le, "at most")
      return f"have {bound} {count} element{'s' * (count != 1)}"
    return "name each element once" if self.unique and len(set(value)) < len(value) else ""


_TYPES: Final = {
  float: (Real, "be a number"),
  int: (Integral, "be a whole number"),
  str: (str, "be a string"),
  bool: (bool, "be a bool"),
}
_TYPE_RULES = (*(rule for _, rule in _TYPES.values()), "be a tuple", "be a mapping")

Count = Annotated[int, Limits(ge=0)]
"""Whole number from 0 on."""
PositiveCount = Annotated[int, Limits(ge=1)]
"""Whole number from 1 on."""
NonNegative = Annotated[float, Limits(ge=0)]
"""Finite number from 0 on."""
Positive = Annotated[float, Limits(gt=0)]
"""Finite number above 0."""
Finite = Annotated[float, Limits()]
"""Finite number."""
Share = Annotated[float, Limits(ge=0, le=1)]
"""Number in [0, 1]."""
Range = Annotated[tuple[float, float], Limits(), Ascending()]
"""Least and greatest value, finite."""
NonNegativeRange = Annotated[Range, Limits(ge=0)]
"""Least and greatest value, finite, from 0 on."""
Bounds = Annotated[tuple[float, float], Limits(finite=False), Ascending()]
"""Least and greatest value, either of them possibly infinite."""


def check_fields(cfg: Any, owner: str, others: Iterable[str] = ()) -> None:
  """Raise ConfigError with the fields of a dataclass that break their annotations; messages begin with `owner`.

  If there are none, `others` are the problems. It may be a generator that relies on the annotations.
  """
  if problems := field_problems(cfg) or list(others):
    raise ConfigError(*(f"{owner}: {problem}" for problem in problems))


def require(value: object, kind: type[T], otherwise: str) -> T:
  """Return a value that must be of this type.

  Raises:
    ConfigError: The value has another type; the message is `otherwise`.
  """
  if not isinstance(value, kind):
    raise ConfigError(otherwise)
  return value


def field_problem(value: Any, hint: Any) -> str:
  """Return the reason why a value breaks an annotation, to follow the value's name; empty if it does not."""
  rule = _broken_rule(value, hint)
  return f"must {rule}, got {value!r}" if rule else ""


def named_problem(name: str, value: Any, hint: Any) -> str:
  """Return `field_problem` with the value's name, and with the nearest choices of a misspelt one; empty if valid."""
  problem = field_problem(value, hint)
  return problem and (_names_close(name, value, hint) or f"{name} {problem}")


def check_value(name: str, value: Any, hint: Any) -> None:
  """Raise ConfigError, beginning with `name`, if a value breaks an annotation."""
  if problem := named_problem(name, value, hint):
    raise ConfigError(problem)


def field_problems(cfg: Any) -> list[str]:
  """Return one line for each field of a dataclass that breaks a constraint, without the name of the config."""
  hints = field_hints(type(cfg))
  names = [field.name for field in fields(cfg) if field.name in hints]
  return [problem for name in names if (problem := named_problem(name, getattr(cfg, name), hints[name]))]


@cache
def field_hints(cls: type) -> dict[str, Any]:
  """Return the annotations of fields that can be resolved."""
  hints: dict[str, Any] = {}
  for base in reversed(cls.__mro__):
    own = vars(base).get("__annotations__", {})
    # Code that was run without a module has only its own names.
    namespace = vars(sys.modules.get(base.__module__, builtins))
    hints = {name: hint for name, hint in hints.items() if name not in own}
    hints |= resolved_hints(own, namespace, dict(vars(base)))
  return hints


def resolved_hints(hints: Mapping[str, Any], namespace: dict[str, Any], local: dict[str, Any]) -> dict[str, Any]:
  """Return the annotations that can be resolved; others, such as names that only type checkers import, are left out."""
  resolved: dict[str, Any] = {}
  for name, hint in hints.items():
    holder: Any = types.SimpleNamespace(__annotations__={name: hint})
    with suppress(NameError, AttributeError, TypeError, SyntaxError):
      resolved |= get_type_hints(holder, namespace, local, include_extras=True)
  return resolved


def _broken_rule(value: Any, hint: Any) -> str:
  """Return the rule of an annotation that a value breaks, to follow "must"; empty if it keeps all."""
  origin, args = get_origin(hint), get_args(hint)
  if origin is Annotated:
    rules = [rule for rule in args[1:] if isinstance(rule, Limits | Ascending | Items)]
    return _broken_rule(value, args[0]) or _first(rule.problem(value) for rule in rules)
  if origin in (Union, types.UnionType):
    broken = {_broken_rule(value, arg): arg for arg in args if arg is not type(None) or value is None}
    if "" in broken:
      return ""
    # A part for values of this type explains the mistake best.
    return " or ".join([rule for rule, arg in broken.items() if _is_for(value, rule, arg)] or broken)
  if origin is Literal:
    return "" if value in args else f"be {' or '.join(map(repr, args))}"
  if origin is tuple:
    return _broken_by_elements(value, args)
  if isinstance(origin, type) and issubclass(origin, Mapping):
    if not isinstance(value, Mapping):
      return "be a mapping"
    return _first(_broken_rule(element, args[1]) for element in value.values())
  kind, rule = _TYPES.get(hint, (object, "")) if isinstance(hint, type) else (object, "")
  is_wrong = not isinstance(value, kind) or (hint in (int, float) and isinstance(value, bool))
  return rule if is_wrong else ""


def _is_for(value: Any, rule: str, hint: Any) -> bool:
  """Return True if an annotation accepts the type of a value, and only the rule refuses the value itself."""
  literals = [type(choice) for choice in get_args(hint)] if get_origin(hint) is Literal else [type(value)]
  return rule not in _TYPE_RULES and type(value) in literals


def _broken_by_elements(value: Any, hints: tuple[Any, ...]) -> str:
  if isinstance(value, str | Mapping) or not hasattr(value, "__len__"):
    return "be a tuple"
  if hints[-1] is ...:
    hints = hints[:1] * len(value)
  if len(value) != len(hints):
    return f"have {len(hints)} elements"
  return _first(_broken_rule(*pair) for pair in zip(value, hints, strict=True))


def _first(rules: Iterable[str]) -> str:
  """Return the first broken rule; empty if none is broken."""
  return next(filter(None, rules), "")


def _names_close(name: str, value: Any, hint: Any) -> str:
  """Return the message for a misspelt name of a `Literal`, with the nearest names; empty for another problem."""
  values = value if isinstance(value, list | tuple) else [value]
  known = list(dict.fromkeys(str(choice) for choice in _choices(hint)))
  wrong = [word for word in values if isinstance(word, str) and word not in known]
  return unknown(name, wrong[0], known) if known and wrong else ""


def _choices(hint: Any) -> Iterator[Any]:
  """Yield the choices of all `Literal`s of an annotation."""
  if get_origin(hint) is Literal:
    yield from get_args(hint)
  else:
    for arg in get_args(hint):
      yield from _choices(arg)


def _numbers(value: Any) -> Iterator[float]:
  if isinstance(value, Real):
    yield float(value)
  elif isinstance(value, Mapping):
    for inner in value.values():
      yield from _numbers(inner)
  elif not isinstance(value, str) and hasattr(value, "__len__"):
    for inner in value:
      yield from _numbers(inner)
