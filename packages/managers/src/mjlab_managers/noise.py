"""Noise on observations: configs, and one pass that applies the noise of all terms."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import torch
from mjlab_core import Config, Limits, Range, Stateful, check_fields, check_value, where_

Operation = Literal["add", "scale", "abs"]
PerDim = Annotated[float | tuple[float, ...], Limits()]
"""One number for all components of a term, or one per component."""


@dataclass(kw_only=True)
class NoiseCfg(Config, ABC):
  """Base of noise configs.

  The noise of a component is n = base + u width + z std, with u uniform in [0, 1] and z standard normal.
  """

  operation: Operation = "add"
  """Result for a value x: `add` gives x + n, `scale` gives x * n, `abs` gives n."""

  @abstractmethod
  def affine(self) -> tuple[PerDim, PerDim, PerDim]:
    """Return base, width and std.

    Raises:
      ValueError: the config is wrong.
    """


@dataclass(kw_only=True)
class ConstantNoiseCfg(NoiseCfg):
  """Constant noise."""

  bias: PerDim = 0.0

  def affine(self) -> tuple[PerDim, PerDim, PerDim]:
    return self.bias, 0.0, 0.0


@dataclass(kw_only=True)
class UniformNoiseCfg(NoiseCfg):
  """Uniform noise in [n_min, n_max]."""

  n_min: PerDim = -1.0
  n_max: PerDim = 1.0

  def affine(self) -> tuple[PerDim, PerDim, PerDim]:
    length = max(len(_tuple(self.n_min)), len(_tuple(self.n_max)))
    ends = [_spread(value, length, "UniformNoiseCfg") for value in (self.n_min, self.n_max)]
    pairs = list(zip(*ends, strict=True))
    for pair in pairs:
      check_value("UniformNoiseCfg: (n_min, n_max)", pair, Range)
    return ends[0], tuple(hi - lo for lo, hi in pairs), 0.0


@dataclass(kw_only=True)
class GaussianNoiseCfg(NoiseCfg):
  """Normal noise with `mean` and standard deviation `std`."""

  mean: PerDim = 0.0
  std: Annotated[PerDim, Limits(ge=0)] = 1.0

  def affine(self) -> tuple[PerDim, PerDim, PerDim]:
    return self.mean, 0.0, self.std


@dataclass(kw_only=True)
class NoiseModelWithAdditiveBiasCfg(Config):
  """Noise, then a bias that is drawn at every reset and added during the whole episode."""

  bias_noise_cfg: NoiseCfg
  """Distribution of the bias; its `operation` does not matter."""
  noise_cfg: NoiseCfg | None = None
  sample_bias_per_component: bool = True
  """True: one draw for each component of the term; False: the draw of the first one for all."""


class NoiseModel(Stateful, ABC):
  """Noise for one shape of term with state for each episode, built by a `NoiseModelCfg`."""

  @abstractmethod
  def reset(self, mask: torch.Tensor) -> None:
    """Begin new episodes in the worlds of `mask`, bool (N,): draw for all worlds, and change only these."""

  @abstractmethod
  def apply_(self, x: torch.Tensor) -> None:
    """Apply the noise to the value of a term, float32 (N, *shape), in place, without a change of state."""


@dataclass(kw_only=True)
class NoiseModelCfg(Config, ABC):
  """Base of configs of custom noise, such as noise of images."""

  @abstractmethod
  def build(
    self, shape: tuple[int, ...], num_envs: int, device: torch.device | str, generator: torch.Generator
  ) -> NoiseModel:
    """Return the noise for a term of this shape. It draws from `generator` and keeps its state on `device`.

    Raises:
      ValueError: the config is wrong, or does not fit the term.
    """


class FusedNoise:
  """Noise of many columns, applied together.

  Args:
    parts: first column, column after the last, and noise of each noisy term.
    device: device of the columns.
  """

  def __init__(self, parts: Sequence[tuple[int, int, NoiseCfg]], device: torch.device | str) -> None:
    self.start = min(start for start, _, _ in parts)
    self.stop = max(stop for _, stop, _ in parts)
    columns = self.stop - self.start
    base, width, std = (torch.zeros(1, columns) for _ in range(3))
    scales, replaces = (torch.zeros(1, columns, dtype=torch.bool) for _ in range(2))
    for start, stop, cfg in parts:
      check_fields(cfg, type(cfg).__name__)
      where = slice(start - self.start, stop - self.start)
      for vector, value in zip((base, width, std), cfg.affine(), strict=True):
        vector[0, where] = torch.tensor(_spread(value, stop - start, type(cfg).__name__))
      scales[0, where] = cfg.operation == "scale"
      replaces[0, where] = cfg.operation == "abs"
    self._base = base.to(device)
    self._width = width.to(device) if width.any() else None
    self._std = std.to(device) if std.any() else None
    self._scales = scales.to(device) if scales.any() else None
    self._replaces = replaces.to(device) if replaces.any() else None
    self._device = device

  def sample(self, num_envs: int, generator: torch.Generator) -> torch.Tensor:
    """Return noise for columns `start` to `stop`, (num_envs, stop - start), or (1, ...) if nothing is random."""
    shape = (num_envs, self.stop - self.start)
    noise = self._base
    if self._width is not None:
      noise = torch.addcmul(noise, torch.rand(shape, generator=generator, device=self._device), self._width)
    if self._std is not None:
      noise = torch.addcmul(noise, torch.randn(shape, generator=generator, device=self._device), self._std)
    return noise

  def apply_(self, frame: torch.Tensor, generator: torch.Generator) -> None:
    """Apply the noise to `frame`, float32 (num_envs, all columns), in place."""
    x = frame[:, self.start : self.stop]
    noise = self.sample(frame.shape[0], generator)
    if self._scales is None and self._replaces is None:
      x.add_(noise)
      return
    y = x + noise
    if self._scales is not None:
      y = torch.where(self._scales, x * noise, y)
    if self._replaces is not None:
      y = torch.where(self._replaces, noise, y)
    x.copy_(y)


class EpisodeBias:
  """Biases of many columns, each constant over an episode.

  Args:
    parts: first column, column after the last, and noise of each term with a bias.
    values: memory of the biases, (num_envs, all columns), owned by the caller.
    generator: source of the draws.
  """

  def __init__(
    self,
    parts: Sequence[tuple[int, int, NoiseModelWithAdditiveBiasCfg]],
    values: torch.Tensor,
    generator: torch.Generator,
  ) -> None:
    self._noise = FusedNoise([(start, stop, cfg.bias_noise_cfg) for start, stop, cfg in parts], values.device)
    self._values = values[:, self._noise.start : self._noise.stop]
    self._generator = generator
    source = list(range(self._noise.stop - self._noise.start))
    for start, stop, cfg in parts:
      if cfg.sample_bias_per_component:
        continue
      first = start - self._noise.start
      source[first : stop - self._noise.start] = [first] * (stop - start)
    shared = source != list(range(len(source)))
    self._source = torch.tensor(source, device=values.device) if shared else None

  def redraw(self, mask: torch.Tensor) -> None:
    """Draw biases for all worlds and keep those of the worlds in `mask`, bool (N,)."""
    draw = self._noise.sample(self._values.shape[0], self._generator)
    if self._source is not None:
      draw = draw.index_select(1, self._source)
    where_(self._values, mask, draw)

  def add_to(self, frame: torch.Tensor) -> None:
    """Add the biases to `frame`, (num_envs, all columns), in place."""
    frame[:, self._noise.start : self._noise.stop].add_(self._values)


def _tuple(value: PerDim) -> tuple[float, ...]:
  return tuple(value) if isinstance(value, tuple | list) else (float(value),)


def _spread(value: PerDim, length: int, owner: str) -> tuple[float, ...]:
  values = _tuple(value)
  if len(values) == 1:
    return values * length
  if len(values) != length:
    raise ValueError(f"{owner}: {len(values)} numbers for {length} components.")
  return values
