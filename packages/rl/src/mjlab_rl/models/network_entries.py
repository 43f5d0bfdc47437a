"""Constraints of the settings of image encoders, which rsl-rl does not check."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal, TypedDict

from mjlab_core.constraints import Limits, Positive, field_hints, named_problem

Activation = Literal[
  "elu", "selu", "relu", "crelu", "lrelu", "tanh", "sigmoid", "softplus", "gelu", "swish", "mish", "identity"
]
Sizes = Annotated[int | tuple[int, ...], Limits(ge=1)]


class EncoderEntries(TypedDict, total=False):
  """Constraints of `cnn_cfg`; other entries are free. rsl-rl takes an unknown padding for none."""

  output_channels: Annotated[tuple[int, ...], Limits(ge=1)]
  kernel_size: Sizes
  stride: Sizes
  dilation: Sizes
  padding: Literal["none", "zeros", "reflect", "replicate", "circular"]
  norm: Literal["none", "batch", "layer"] | tuple[Literal["none", "batch", "layer"], ...]
  activation: Activation
  global_pool: Literal["none", "max", "avg"]
  temperature: Positive


def encoder_problems(encoder: dict[str, Any], where: str) -> Iterator[str]:
  """Yield a line for each setting of an image encoder that cannot work."""
  hints = field_hints(EncoderEntries)
  problems = [named_problem(name, value, hints.get(name, Any)) for name, value in encoder.items()]
  yield from (f"{where}.{problem}" for problem in problems if problem)
  if not any(problems):
    layers = len(encoder.get("output_channels", ()))
    for name, value in encoder.items():
      if isinstance(value, (tuple, list)) and len(value) != layers:
        yield f"{where}.{name} has {len(value)} values, output_channels {layers}"
