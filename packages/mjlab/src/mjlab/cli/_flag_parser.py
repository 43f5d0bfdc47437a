"""Flags of a configuration on a command line: tyro reads, completes and explains them."""

import contextlib
import dataclasses
import io
import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, TypeVar, Union

import tyro
from mjlab_core import nearest
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from mjlab.cli._config_flags import Flag, flags, with_values
from mjlab.cli._errors import UsageError

ConfigT = TypeVar("ConfigT")


class _Node:
  """A part of a command line; its fields are flags and parts."""


def parse(config: ConfigT, arguments: Sequence[str]) -> ConfigT:
  """A copy of `config` with the flags of `arguments` set.

  Raises:
    UsageError: No such flag (the message names the nearest), or a value that does not fit.
  """
  known = flags(config)
  # Of the hundreds only those that are named: the time goes with their number.
  words = {word[2:].partition("=")[0].replace("_", "-") for word in arguments}
  named = [flag for flag in known if flag.name in words or _negative(flag) in words]
  parsed = _read(named, arguments)
  if parsed is None:
    raise UsageError(_mistake(known, arguments))
  values = zip(named, _leaves(parsed), strict=True)
  # What was not given comes back as the very object that is there already.
  return with_values(config, [(flag, value) for flag, value in values if value is not flag.value])


def print_help(config: Any, *, prog: str, description: str, word: str = "") -> None:
  """Print the flags of a configuration whose name contains `word`.

  Raises:
    UsageError: There is none.
  """
  known = flags(config)
  word = word.strip("-").replace("_", "-").replace(" ", "-").lower()
  shown = [flag for flag in known if word in flag.name.lower()]
  if not shown:
    close = nearest(word, dict.fromkeys(part for flag in known for part in flag.parts))
    raise UsageError(f"no flag has '{word}' in its name." + (f" Nearest: {', '.join(close)}." if close else ""))
  with contextlib.suppress(SystemExit):
    tyro.cli(_command(shown), args=["--help"], prog=prog, description=description)


def print_completion(configs: Mapping[str, Any], *, prog: str, arguments: Sequence[str]) -> None:
  """Print or write the completion of a command whose first word is a key of `configs`.

  Args:
    configs: Configuration by first word.
    prog: Name of the command.
    arguments: `--tyro-print-completion SHELL` or `--tyro-write-completion SHELL FILE`.

  Raises:
    UsageError: No such shell.
  """
  shells = ("bash", "zsh", "tcsh", "fish")
  if len(arguments) < 2 or arguments[1] not in shells:
    raise UsageError(f"{arguments[0]}: expected {'|'.join(shells)}, got {' '.join(arguments[1:]) or 'nothing'}")
  commands: list[Any] = []
  for name, config in configs.items():
    kind: Any = _command(flags(config))
    commands.append(Annotated[kind, tyro.conf.subcommand(name, prefix_name=False)])
  command: Any = Union[tuple(commands)]  # noqa: UP007
  with contextlib.suppress(SystemExit):
    tyro.cli(command, args=arguments, prog=prog)


def _command(known: Sequence[Flag], depth: int = 0) -> Any:
  """A class for tyro with one field for each flag, nested as their names are."""
  fields: list[tuple[str, Any, Any]] = []
  for (head, is_leaf), group in itertools.groupby(
    known, key=lambda flag: (flag.parts[depth], len(flag.parts) == depth + 1)
  ):
    inside = list(group)
    if is_leaf:
      (flag,) = inside
      kind, about, default = flag.kind, flag.about or None, flag.value
    else:
      kind, about = _command(inside, depth + 1), None
      default = kind()
    # A fresh name each, since a part and its switch have the same; a factory, since lists may not be defaults.
    field = dataclasses.field(default_factory=lambda default=default: default)
    fields.append((f"field_{len(fields)}", Annotated[kind, tyro.conf.arg(name=head, help=about)], field))
  # tyro reads the source of a class for its comments, a second in all; of a built-in class it knows that there is none.
  return dataclasses.make_dataclass("Flags", fields, bases=(_Node,), namespace={"__module__": "builtins"})


def _leaves(node: _Node) -> Iterator[Any]:
  for value in vars(node).values():
    if isinstance(value, _Node):
      yield from _leaves(value)
    else:
      yield value


def _read(known: Sequence[Flag], arguments: Sequence[str]) -> _Node | None:
  """What tyro makes of the arguments; None where it refuses or leaves any."""
  # Its message is a box of many lines; ours is one.
  with contextlib.redirect_stderr(io.StringIO()):
    try:
      parsed, left = tyro.cli(_command(known), args=arguments, return_unknown_args=True)
    except SystemExit:
      return None
  return None if left else parsed


def _mistake(known: Sequence[Flag], arguments: Sequence[str]) -> str:
  """What is wrong with arguments that were refused: the first flag that is refused alone."""
  spelled = {flag.name: flag for flag in known}
  spelled |= {_negative(flag): flag for flag in known if flag.kind is bool}
  given: list[list[str]] = []
  for word in arguments:
    if word.startswith("--"):
      given.append([word])
    elif given:
      given[-1].append(word)
    else:
      return f"'{word}': not a flag"
  for first, *rest in given:
    name, equals, value = first[2:].partition("=")
    flag = spelled.get(name.replace("_", "-"))
    if flag is None:
      return _unknown(name.replace("_", "-"), [flag.name for flag in known])
    if _read([flag], [first, *rest]) is None:
      got = " ".join([value, *rest] if equals else rest) or "nothing"
      return f"--{flag.name}: expected {_expected(flag)}, got {got}"
  return f"{' '.join(arguments)}: not understood"


def _expected(flag: Flag) -> str:
  if flag.kind is bool:
    return f"no value (--{_negative(flag)} switches it off)"
  spec = ConstructorRegistry.get_primitive_spec(PrimitiveTypeInfo.make(flag.kind, set()))
  assert isinstance(spec, PrimitiveConstructorSpec)
  return spec.metavar


def _negative(flag: Flag) -> str:
  return ".".join([*flag.parts[:-1], f"no-{flag.parts[-1]}"])


def _unknown(name: str, known: Sequence[str]) -> str:
  inside = [flag for flag in known if flag.startswith(f"{name}.")]
  if inside:
    shown = ", ".join(f"--{flag}" for flag in inside[:3]) + (", ..." if len(inside) > 3 else "")
    return f"--{name}: not a single value; its options are {shown}"
  # A part of the same name elsewhere is likelier meant than a name that merely looks alike.
  last = name.rpartition(".")[2]
  close = nearest(name, [flag for flag in known if flag.rpartition(".")[2] == last] or known)
  return f"--{name}: no such option." + (f" Did you mean --{close[0]}?" if close else "")
