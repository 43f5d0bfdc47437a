"""Every number, switch, word and tuple of every task can be given on the command line."""

import dataclasses
import enum
from typing import Any

import mjlab
import pytest
from mjlab.cli._flags import flags, parse

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


@pytest.mark.parametrize("name", mjlab.list_tasks())
def test_every_number_switch_word_and_tuple_of_a_task_is_a_flag_that_sets_it(name: str) -> None:
  task = mjlab.load_task(name)
  config = Configs(task.env, task.agent)
  wanted = {path: another(leaf) for path, leaf in leaves(config).items()}
  known = {flag.path: flag.name for flag in flags(config)}
  assert wanted.keys() <= known.keys()
  given: list[str] = []
  for path, value in wanted.items():
    before, _, last = known[path].rpartition(".")
    if isinstance(value, bool):
      given.append(f"--{known[path]}" if value else f"--{before}.no-{last}")
    elif isinstance(value, tuple | list):
      given += [f"--{known[path]}", *words(value)]
    else:
      given.append(f"--{known[path]}={words(value)[0]}")
  changed = leaves(parse(config, given))
  # One name may come back as itself or as a row of one.
  assert {path: words(value) for path, value in changed.items()} == {path: words(v) for path, v in wanted.items()}
