"""Every number, switch, word and tuple of every task can be given on the command line."""

import dataclasses
import enum
from typing import Any

import mjlab
from mjlab.cli.shared._flags import flags, parse

Path = tuple[Any, ...]


def is_leaf(value: Any) -> bool:
  if isinstance(value, tuple | list):
    return bool(value) and all(item is None or is_leaf(item) for item in value)
  return isinstance(value, bool | int | float | str | enum.Enum)


def leaves(value: Any, path: Path = ()) -> dict[Path, Any]:
  """What a configuration is made of, by attribute names, keys and indices from the root."""
  if is_leaf(value):
    return {path: value}
  inside: list[tuple[Any, Any]] = []
  if dataclasses.is_dataclass(value) and not isinstance(value, type):
    inside = [(field.name, getattr(value, field.name)) for field in dataclasses.fields(value)]
  elif isinstance(value, dict):
    inside = list(value.items())
  elif isinstance(value, tuple | list):
    inside = list(enumerate(value))
  return {where: leaf for name, item in inside for where, leaf in leaves(item, (*path, name)).items()}


def another(value: Any) -> Any:
  """A value of the same kind; words may be one of a few, and stay."""
  if isinstance(value, tuple | list):
    return type(value)(another(item) for item in value)
  return not value if isinstance(value, bool) else value + 1 if isinstance(value, int | float) else value


def words(value: Any) -> list[str]:
  """As it is typed."""
  if isinstance(value, tuple | list):
    return [word for item in value for word in words(item)]
  return [value.name if isinstance(value, enum.Enum) else str(value)]


@dataclasses.dataclass
class Configs:
  env: Any
  agent: Any


def test_every_number_switch_word_and_tuple_of_a_task_is_a_flag_that_sets_it() -> None:
  # A flag that two tasks have with the same type is given to one of them: reading takes long.
  given_before: set[tuple[Path, str]] = set()
  for name in mjlab.list_tasks():
    task = mjlab.load_task(name)
    config = Configs(task.env, task.agent)
    before = leaves(config)
    known = {flag.path: flag for flag in flags(config)}
    assert before.keys() <= known.keys(), name
    wanted = {path: another(leaf) for path, leaf in before.items() if (path, str(known[path].kind)) not in given_before}
    given_before |= {(path, str(known[path].kind)) for path in wanted}
    given: list[str] = []
    for path, value in wanted.items():
      flag = known[path]
      if isinstance(value, bool):
        given.append(f"--{flag.name if value else flag.negative}")
      elif isinstance(value, tuple | list):
        given += [f"--{flag.name}", *words(value)]
      else:
        given.append(f"--{flag.name}={words(value)[0]}")
    changed = leaves(parse(config, given))
    # One name may come back as itself or as a row of one.
    expected = {path: words(value) for path, value in (before | wanted).items()}
    assert {path: words(value) for path, value in changed.items()} == expected, name
