"""Flags of a configuration: `--env.rewards.foot-slip.weight -0.2`. tyro reads their values and completes them.

A flag is the path to a value, with hyphens for underscores; keys of dictionaries and indices of tuples are parts of it.
Setting a flag copies the objects along its path, so that functions, shared parts and other values stay the same
objects. The flag of a term or part that may be `None` takes `None`, which removes it.

tyro alone does not offer this: it rebuilds the whole configuration, has no flag that removes a part, cannot search its
help, prints none for some tasks, and takes up to half a second longer (docs/benchmarks/parsers.md).
"""

import contextlib
import copy
import dataclasses
import enum
import functools
import itertools
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Literal, TypeVar, Union

import tyro
from mjlab_core import UsageError, nearest
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from mjlab.cli.shared._help import FlagRow, field_docs, own_fields_first, shown

ConfigT = TypeVar("ConfigT")

# The flag of a whole term or part.
_PART: Any = Literal["on", "None"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Flag:
  """One value of a configuration that can be set."""

  path: tuple[Any, ...]
  """Attribute names, keys and indices from the root."""
  value: Any
  """Present value; "on" for a whole part."""
  kind: Any
  """Type that tyro reads."""
  owner: type | None = None
  """Dataclass of which the value is a field; None for items of containers."""

  @property
  def about(self) -> str:
    """Meaning of the value."""
    if self.kind is _PART:
      return "None removes it."
    # Source is read for a help text only: it takes longer than all else here.
    return "" if self.owner is None else field_docs(self.owner).get(self.path[-1], "")

  @functools.cached_property
  def name(self) -> str:
    """Name without the two hyphens: "env.rewards.foot-slip.weight"."""
    # A dot at the end of a pattern would make an empty part.
    return ".".join(str(part).strip(".").replace("_", "-") for part in self.path)

  @property
  def negative(self) -> str:
    """Name that switches a switch off: "env.sim.no-capture"."""
    head, dot, last = self.name.rpartition(".")
    return f"{head}{dot}no-{last}"


def flags(config: Any) -> list[Flag]:
  """Return all flags of a configuration, in the order of its fields; of equal names only the last."""
  return list({flag.name: flag for flag in _walk(config, (), Any)}.values())


def replaced(config: Any, path: Sequence[Any], new: Any) -> Any:
  """Return a copy of `config` with another value at `path`; objects off the path are shared with the original."""
  if not path:
    return new
  head, rest = path[0], path[1:]
  if isinstance(config, tuple):
    return tuple(replaced(item, rest, new) if i == head else item for i, item in enumerate(config))
  changed = copy.copy(config)
  if dataclasses.is_dataclass(config):
    # Frozen classes too; checks run again when the environment is built.
    object.__setattr__(changed, head, replaced(getattr(config, head), rest, new))
  else:
    changed[head] = replaced(config[head], rest, new)
  return changed


def parse(config: ConfigT, words: Sequence[str]) -> ConfigT:
  """Return a copy of `config` with the flags in `words` set.

  Raises:
    UsageError: A flag does not exist (the message names the nearest), or a value does not fit.
  """
  known = {flag.name: flag for flag in flags(config)}
  switched_off = {flag.negative: flag for flag in known.values() if flag.kind is bool}
  given: dict[str, Any] = {}
  for word, values in grouped(words):
    name, equals, value = word.removeprefix("--").partition("=")
    name = name.replace("_", "-")
    flag = known.get(name) or switched_off.get(name)
    if flag is None:
      raise UsageError(_unknown(name, [*known, *switched_off]))
    values = [value, *values] if equals else values
    given[flag.name] = name in known if flag.kind is bool and not values else _read(flag, values)
  # From the back: values inside a part are set before the part is removed.
  for flag in reversed(known.values()):
    if flag.name in given and given[flag.name] is not flag.value:
      config = replaced(config, flag.path, None if flag.kind is _PART else given[flag.name])
  return config


def help_rows(config: Any) -> list[FlagRow]:
  """Return the flags of a configuration for a help text."""
  rows = []
  for flag in flags(config):
    spec = _spec(flag.kind)
    choices = f"| --{flag.negative}" if flag.kind is bool else spec.metavar if spec is not None else ""
    rows.append(FlagRow(flag.name, choices, shown(flag.value), flag.about))
  return rows


def print_completion(configs: Mapping[str, Any], *, prog: str, words: Sequence[str]) -> None:
  """Print or write the shell completion of a command that takes a key of `configs` and then flags.

  Args:
    configs: Configuration by first word.
    prog: Name of the command.
    words: `--tyro-print-completion SHELL` or `--tyro-write-completion SHELL FILE`.

  Raises:
    UsageError: The shell is unknown.
  """
  shells = ("bash", "zsh", "tcsh", "fish")
  if len(words) < 2 or words[1] not in shells:
    raise UsageError(f"{words[0]}: expected {'|'.join(shells)}, got {' '.join(words[1:]) or 'nothing'}")
  commands: list[Any] = []
  for name, config in configs.items():
    fields: list[tuple[str, Any, Any]] = []
    for flag in flags(config):
      kind = Annotated[flag.kind, tyro.conf.arg(name=flag.name, help=flag.about or None)]
      # A factory, because a list may not be a default.
      default = dataclasses.field(default_factory=lambda value=flag.value: value)
      fields.append((f"field_{len(fields)}", kind, default))
    # tyro reads the source of a class for comments, except of a built-in class; that takes a second in all.
    parser: Any = dataclasses.make_dataclass("Flags", fields, namespace={"__module__": "builtins"})
    commands.append(Annotated[parser, tyro.conf.subcommand(name, prefix_name=False)])
  command: Any = Union[tuple(commands)]  # noqa: UP007
  with contextlib.suppress(SystemExit):
    tyro.cli(command, args=words, prog=prog)


def _walk(value: Any, path: tuple[Any, ...], annotation: Any, owner: type | None = None) -> Iterator[Flag]:
  if dataclasses.is_dataclass(value) and not isinstance(value, type):
    if type(None) in typing.get_args(annotation):
      yield Flag(path=path, value="on", kind=_PART)
    hints = _hints(type(value))
    for field in dataclasses.fields(value) if path else own_fields_first(type(value)):
      if field.init and not field.name.startswith("_"):
        kind = hints.get(field.name, Any)
        yield from _walk(getattr(value, field.name), (*path, field.name), kind, type(value))
  elif isinstance(value, Mapping):
    for key, item in value.items():
      if isinstance(key, (str, int)):
        yield from _walk(item, (*path, key), _item_annotation(annotation))
  elif (kind := _kind(annotation, value)) is not None:
    yield Flag(path=path, value=value, kind=kind, owner=owner)
  elif isinstance(value, (tuple, list)):
    for index, item in enumerate(value):
      yield from _walk(item, (*path, index), Any)


@functools.cache
def _hints(cls: type) -> dict[str, Any]:
  try:
    return typing.get_type_hints(cls)
  except (NameError, TypeError, AttributeError):
    # Some types are imported for the type checker only; the types of the present values are used instead.
    return {}


def _item_annotation(annotation: Any) -> Any:
  """Return the type of the values of a dictionary; Any if the annotation has no dictionary."""
  tables = (kind for kind in (annotation, *typing.get_args(annotation)) if typing.get_origin(kind) in (dict, Mapping))
  return next((typing.get_args(kind)[1] for kind in tables), Any)


def _kind(annotation: Any, value: Any) -> Any:
  """Return the annotation if tyro can read it and the value is such a one, else the type of the value, else None."""
  members = typing.get_args(annotation) if typing.get_origin(annotation) in (Union, types.UnionType) else (annotation,)
  kinds = [_tuple_of(*typing.get_args(kind), ...) if typing.get_origin(kind) is Sequence else kind for kind in members]
  # The first that fits is taken, and every word is a string.
  kind = Union[tuple(sorted(kinds, key=lambda kind: str in (kind, *typing.get_args(kind))))]  # noqa: UP007
  spec = _spec(kind)
  return kind if spec is not None and spec.is_instance(value) else _type_of(value)


@functools.cache
def _spec(kind: Any) -> PrimitiveConstructorSpec[Any] | None:
  """Return how tyro reads a type; None if it cannot."""
  spec = ConstructorRegistry.get_primitive_spec(PrimitiveTypeInfo.make(kind, set()))
  return spec if isinstance(spec, PrimitiveConstructorSpec) else None


def _type_of(value: Any) -> Any:
  """Return the type of a value without annotation, such as a parameter of a term; None if it cannot be typed."""
  if isinstance(value, enum.Enum):
    return type(value)
  if type(value) in (bool, int, float, str):
    # A whole number may be set to a fraction.
    return int | float if type(value) is int else type(value)
  if isinstance(value, (tuple, list)) and value:
    kinds = [_type_of(item) for item in value]
    if None in kinds:
      return None
    if isinstance(value, list):
      return types.GenericAlias(list, kinds[0])
    # The length of a tuple of numbers has a meaning, that of a tuple of names has none.
    return _tuple_of(str, ...) if kinds[0] is str else _tuple_of(*kinds)
  return None


def _tuple_of(*kinds: Any) -> Any:
  return types.GenericAlias(tuple, kinds)


def grouped(words: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
  """Yield each flag with the words that follow it."""
  if words and not words[0].startswith("--"):
    raise UsageError(f"'{words[0]}': not a flag")
  starts = [number for number, word in enumerate(words) if word.startswith("--")]
  for start, end in itertools.pairwise([*starts, len(words)]):
    yield words[start], list(words[start + 1 : end])


def _read(flag: Flag, values: list[str]) -> Any:
  """Return the value of a flag from its words.

  Raises:
    UsageError: They do not fit.
  """
  expected = f"no value (--{flag.negative} switches it off)"
  if flag.kind is not bool and (spec := _spec(flag.kind)) is not None:
    expected = spec.metavar
    counts = spec.nargs if isinstance(spec.nargs, tuple) else (spec.nargs,)
    if "*" in counts or len(values) in counts:
      # tyro raises KeyError for enumerations.
      with contextlib.suppress(ValueError, KeyError):
        return spec.instance_from_str(values)
  raise UsageError(f"--{flag.name}: expected {expected}, got {' '.join(values) or 'nothing'}")


def _unknown(name: str, known: Sequence[str]) -> str:
  inside = [flag for flag in known if flag.startswith(f"{name}.")]
  if inside:
    shown = ", ".join(f"--{flag}" for flag in inside[:3]) + (", ..." if len(inside) > 3 else "")
    return f"--{name}: not a single value; its options are {shown}"
  # A flag of the same last name elsewhere is more likely meant than one that is only spelled alike.
  last = name.rpartition(".")[2]
  close = nearest(name, [flag for flag in known if flag.rpartition(".")[2] == last] or known)
  return f"--{name}: no such option." + (f" Did you mean --{close[0]}?" if close else "")
