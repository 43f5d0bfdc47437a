"""Values that a sweep tries, and what its trials share."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import msgspec
from mjlab_core import UsageError
from mjlab_core.io.files import reading
from mjlab_core.names import check_name
from msgspec import Meta

from mjlab.registry import load_task

Scalar = float | int | bool | str


class Range(msgspec.Struct, forbid_unknown_fields=True):
  """Numbers between two limits."""

  low: float
  high: float
  log: bool = False
  """Draw the logarithm uniformly."""

  def __post_init__(self) -> None:
    if not (0.0 if self.log else -math.inf) < self.low < self.high:
      raise ValueError(f"needs {'0 < ' if self.log else ''}low < high")


class Space(msgspec.Struct, forbid_unknown_fields=True):
  """Values to try."""

  values: Annotated[dict[str, Annotated[list[Scalar], Meta(min_length=1)] | Range], Meta(min_length=1)]
  """By flag: a list of values, or a range."""
  perturb: list[str] = []
  """Flags among them whose values pbt may change; the others keep the value that a trial has drawn."""


class Sweep(msgspec.Struct):
  """All that a trial needs, and that a resumed sweep takes over."""

  task: str
  flags: list[str]
  """Flags that all trials have."""
  space: Space
  trials: int
  scheduler: Literal["asha", "pbt", "none"]
  max_iterations: int
  gpus: float
  cpus: int
  seed: int


class Trial(msgspec.Struct):
  """Result of a trial."""

  name: str
  values: dict[str, Scalar]
  reward: float
  """Its last mean reward; NaN before the first."""
  iterations: int
  state: str


def read_space(path: str) -> Space:
  """Read the file of `--space`.

  Raises:
    FileError: It cannot be read, or is not of that form.
  """
  import yaml

  with reading("space", path, 2**20) as file:
    try:
      found = yaml.safe_load(file.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
      raise ValueError(" ".join(str(error).split())) from error
    # YAML takes 1e-4 for a text.
    return msgspec.convert({} if found is None else found, Space, strict=False)


def trial_flags(values: Mapping[str, Scalar]) -> list[str]:
  """Return the values of a trial as flags."""
  words: list[str] = []
  for name, value in values.items():
    if isinstance(value, bool):
      part, _, leaf = name.rpartition(".")
      words.append(f"--{name}" if value else f"--{part}.no-{leaf}")
    else:
      words += [f"--{name}", str(value)]
  return words


def check(sweep: Sweep) -> None:
  """Try the values of a sweep on its task.

  Raises:
    UsageError: A flag does not exist or does not take a value, or pbt cannot change it.
  """
  from mjlab.cli.shared._flags import parse

  space = sweep.space
  choices = {name: [x.low, x.high] if isinstance(x, Range) else x for name, x in space.values.items()}
  task = load_task(sweep.task)
  wanted = task
  for i in range(max(map(len, choices.values()))):
    values = {name: values[min(i, len(values) - 1)] for name, values in choices.items()}
    wanted = parse(task, [*sweep.flags, *trial_flags(values)])
  if sweep.scheduler == "pbt":
    _check_perturbed(space, wanted.agent)


def _check_perturbed(space: Space, agent: Any) -> None:
  """Check that pbt can change the values that it may change."""
  if not space.perturb:
    raise UsageError("--space: pbt needs the names of values that it may change: perturb: [...]")
  for name in space.perturb:
    check_name("value", name, space.values, "--space: perturb")
    parts = name.split(".")
    if parts[0] == "env" and not (parts[1:2] == ["rewards"] and parts[3:] == ["weight"]):
      raise UsageError(f"--space: perturb: {name} cannot change; of the environment only weights of rewards can")
    is_rate = name.replace("_", "-") == "agent.algorithm.learning-rate"
    if is_rate and getattr(agent.algorithm, "schedule", "fixed") != "fixed":
      raise UsageError(f"--space: perturb: {name} needs --agent.algorithm.schedule fixed")
