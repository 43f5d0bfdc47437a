"""Constraints of the dictionaries in a network's configuration, which rsl-rl does not check."""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Annotated, Any, Literal

from mjlab_core.constraints import Limits, Positive, field_problems

Activation = Literal[
  "elu", "selu", "relu", "crelu", "lrelu", "tanh", "sigmoid", "softplus", "gelu", "swish", "mish", "identity"
]
Sizes = Annotated[int | tuple[int, ...], Limits(ge=1)]


@dataclass
class DistributionEntries:
  """Constraints of `distribution_cfg`; other entries are free."""

  init_std: Positive = 1.0


@dataclass
class EncoderEntries:
  """Constraints of `cnn_cfg`; other entries are free. rsl-rl takes an unknown padding for none."""

  output_channels: Annotated[tuple[int, ...], Limits(ge=1)] = ()
  kernel_size: Sizes = 1
  stride: Sizes = 1
  dilation: Sizes = 1
  padding: Literal["none", "zeros", "reflect", "replicate", "circular"] = "none"
  norm: Literal["none", "batch", "layer"] | tuple[Literal["none", "batch", "layer"], ...] = "none"
  activation: Activation = "elu"
  global_pool: Literal["none", "max", "avg"] = "none"
  temperature: Positive = 1.0


def entry_problems(schema: type[Any], entries: dict[str, Any], where: str) -> Iterator[str]:
  """Yield a line for each entry of a dictionary that breaks the constraint of its field in `schema`."""
  names = {field.name for field in fields(schema)}
  checked = schema(**{name: value for name, value in entries.items() if name in names})
  yield from (f"{where}.{problem}" for problem in field_problems(checked))


def encoder_problems(encoder: dict[str, Any], where: str) -> Iterator[str]:
  """Yield a line for each setting of an image encoder that cannot work."""
  problems = list(entry_problems(EncoderEntries, encoder, where))
  yield from problems
  if not problems:
    layers = len(encoder.get("output_channels", ()))
    for name, value in encoder.items():
      if isinstance(value, (tuple, list)) and len(value) != layers:
        yield f"{where}.{name} has {len(value)} values, output_channels {layers}"
