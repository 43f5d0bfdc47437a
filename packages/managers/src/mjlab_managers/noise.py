"""Noise on observations: configs, and one pass that applies the noise of all terms."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import torch
from mjlab_core import Config, ConfigError, Limits, Range, Stateful, check_fields, check_value, require, where_

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
      ConfigError: the config is wrong.
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
    length = max(len(value) if isinstance(value, tuple | list) else 1 for value in (self.n_min, self.n_max))
    lows, highs = (_spread(value, length, "UniformNoiseCfg") for value in (self.n_min, self.n_max))
    for pair in zip(lows, highs, strict=True):
      check_value("UniformNoiseCfg: (n_min, n_max)", pair, Range)
    return lows, tuple(hi - lo for lo, hi in zip(lows, highs, strict=True)), 0.0


@dataclass(kw_only=True)
class GaussianNoiseCfg(NoiseCfg):
  """Normal noise with `mean` and standard deviation `std`."""

  mean: PerDim = 0.0
  std: Annotated[PerDim, Limits(ge=0)] = 1.0

  def affine(self) -> tuple[PerDim, PerDim, PerDim]:
    return self.mean, 0.0, self.std


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


@dataclass(kw_only=True)
class NoiseModelWithAdditiveBiasCfg(NoiseModelCfg):
  """Noise, then a bias that is drawn at every reset and added during the whole episode."""

  bias_noise_cfg: NoiseCfg
  """Distribution of the bias; its `operation` does not matter."""
  noise_cfg: NoiseCfg | None = None
  sample_bias_per_component: bool = True
  """True: one draw for each component of the term; False: the draw of the first one for all."""

  def build(
    self, shape: tuple[int, ...], num_envs: int, device: torch.device | str, generator: torch.Generator
  ) -> NoiseModel:
    return _AdditiveBias(self, math.prod(shape), num_envs, device, generator)


class _AdditiveBias(NoiseModel):
  def __init__(
    self,
    cfg: NoiseModelWithAdditiveBiasCfg,
    width: int,
    num_envs: int,
    device: torch.device | str,
    generator: torch.Generator,
  ) -> None:
    check_fields(cfg, "NoiseModelWithAdditiveBiasCfg")
    self.num_envs, self.device = num_envs, torch.device(device)
    self._generator, self._per_component = generator, cfg.sample_bias_per_component
    whole = slice(0, width)
    self._bias_noise = FusedNoise([(whole, cfg.bias_noise_cfg)], device)
    self._noise = FusedNoise([(whole, cfg.noise_cfg)], device) if cfg.noise_cfg is not None else None
    self._bias = self.state_of(torch.zeros(num_envs, width, device=device))
    self.reset(torch.ones(num_envs, dtype=torch.bool, device=device))

  def reset(self, mask: torch.Tensor) -> None:
    bias = self._bias_noise.sample(self.num_envs, self._generator)
    where_(self._bias, mask, bias if self._per_component else bias[:, :1])

  def apply_(self, x: torch.Tensor) -> None:
    if self._noise is not None:
      self._noise.apply_(x.flatten(1), self._generator)
    x.add_(self._bias.view_as(x))


class FusedNoise:
  """Noise of many columns, applied together.

  Args:
    parts: columns and noise of each noisy term.
    device: device of the columns.

  Raises:
    ConfigError: a config is wrong, or does not fit its columns.
  """

  def __init__(self, parts: Sequence[tuple[slice, NoiseCfg]], device: torch.device | str) -> None:
    self._columns = slice(min(where.start for where, _ in parts), max(where.stop for where, _ in parts))
    self._width, self._device = self._columns.stop - self._columns.start, device
    vectors = torch.zeros(5, 1, self._width)
    for where, cfg in parts:
      require(cfg, NoiseCfg, f"expected a NoiseCfg or a NoiseModelCfg, got {type(cfg).__name__} {cfg!r}.")
      owner = type(cfg).__name__
      check_fields(cfg, owner)
      own = slice(where.start - self._columns.start, where.stop - self._columns.start)
      values = (*cfg.affine(), float(cfg.operation == "scale"), float(cfg.operation == "abs"))
      for vector, value in zip(vectors, values, strict=True):
        vector[0, own] = torch.tensor(_spread(value, where.stop - where.start, owner))
    base, *others = vectors
    self._base = base.to(device)
    # Vectors of zeros need no operation.
    self._uniform, self._std, scales, replaces = (vector.to(device) if vector.any() else None for vector in others)
    self._scales, self._replaces = (None if mask is None else mask > 0.0 for mask in (scales, replaces))

  def sample(self, num_envs: int, generator: torch.Generator) -> torch.Tensor:
    """Return noise of the columns from the first to the last noisy one, (num_envs, W), or (1, W) if it is constant."""
    shape = (num_envs, self._width)
    noise = self._base
    if self._uniform is not None:
      noise = torch.addcmul(noise, torch.rand(shape, generator=generator, device=self._device), self._uniform)
    if self._std is not None:
      noise = torch.addcmul(noise, torch.randn(shape, generator=generator, device=self._device), self._std)
    return noise

  def apply_(self, frame: torch.Tensor, generator: torch.Generator) -> None:
    """Apply the noise to `frame`, float32 (num_envs, all columns), in place."""
    x = frame[:, self._columns]
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


def _spread(value: PerDim, length: int, owner: str) -> tuple[float, ...]:
  values = tuple(value) if isinstance(value, tuple | list) else (float(value),)
  if len(values) == 1:
    return values * length
  if len(values) != length:
    raise ConfigError(f"{owner}: {len(values)} numbers for {length} components.")
  return values
