"""Noise on observations: configs, and one pass that applies the noise of all terms."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import torch
from mjlab_core import Config, ConfigError, Limits, Range, Stateful, check_fields, check_value, require, where_

from mjlab_managers.env import ManagerEnv
from mjlab_managers.terms.binding import described

Operation = Literal["add", "scale", "abs"]
PerDim = Annotated[float | tuple[float, ...], Limits()]
"""One number for all components of a term, or one per component."""


@dataclass(kw_only=True)
class NoiseCfg(Config, ABC):
  """Base of noise configs.

  The noise of a component is uniform in [low, high], plus normal noise of standard deviation std.
  """

  operation: Operation = "add"
  """Result for a value x and noise n: `add` gives x + n, `scale` gives x * n, `abs` gives n."""

  @abstractmethod
  def distribution(self) -> tuple[PerDim, PerDim, PerDim]:
    """Return low, high and std."""


@dataclass(kw_only=True)
class ConstantNoiseCfg(NoiseCfg):
  """Constant noise."""

  bias: PerDim = 0.0

  def distribution(self) -> tuple[PerDim, PerDim, PerDim]:
    return self.bias, self.bias, 0.0


@dataclass(kw_only=True)
class UniformNoiseCfg(NoiseCfg):
  """Uniform noise in [n_min, n_max]."""

  n_min: PerDim = -1.0
  n_max: PerDim = 1.0

  def distribution(self) -> tuple[PerDim, PerDim, PerDim]:
    return self.n_min, self.n_max, 0.0


@dataclass(kw_only=True)
class GaussianNoiseCfg(NoiseCfg):
  """Normal noise with `mean` and standard deviation `std`."""

  mean: PerDim = 0.0
  std: Annotated[PerDim, Limits(ge=0)] = 1.0

  def distribution(self) -> tuple[PerDim, PerDim, PerDim]:
    return self.mean, self.mean, self.std


class NoiseModel(Stateful, ABC):
  """Noise for one shape of term with state for each episode, built by a `NoiseModelCfg`."""

  def __init__(self, cfg: NoiseModelCfg, env: ManagerEnv) -> None:
    self.cfg, self.num_envs, self.device, self.rng = cfg, env.num_envs, env.device, env.rng

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
  def build(self, shape: tuple[int, ...], env: ManagerEnv) -> NoiseModel:
    """Return the noise for a term of this shape.

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

  def build(self, shape: tuple[int, ...], env: ManagerEnv) -> NoiseModel:
    return _AdditiveBias(self, math.prod(shape), env)


class _AdditiveBias(NoiseModel):
  def __init__(self, cfg: NoiseModelWithAdditiveBiasCfg, width: int, env: ManagerEnv) -> None:
    super().__init__(cfg, env)
    self._per_component, whole = cfg.sample_bias_per_component, slice(0, width)
    self._bias_noise = FusedNoise([(whole, cfg.bias_noise_cfg)], env)
    self._noise = FusedNoise([(whole, cfg.noise_cfg)], env) if cfg.noise_cfg is not None else None
    self._bias = self.state_of(torch.zeros(env.num_envs, width, device=env.device))
    self.reset(torch.ones(env.num_envs, dtype=torch.bool, device=env.device))

  def reset(self, mask: torch.Tensor) -> None:
    bias = self._bias_noise.sample()
    where_(self._bias, mask, bias if self._per_component else bias[:, :1])

  def apply_(self, x: torch.Tensor) -> None:
    if self._noise is not None:
      self._noise.apply_(x.flatten(1))
    x.add_(self._bias.view_as(x))


class FusedNoise:
  """Noise of many columns, applied together.

  Args:
    parts: columns and noise of each noisy term.
    env: the environment.

  Raises:
    ConfigError: a config is wrong, or does not fit its columns.
  """

  def __init__(self, parts: Sequence[tuple[slice, NoiseCfg]], env: ManagerEnv) -> None:
    self._columns = slice(min(where.start for where, _ in parts), max(where.stop for where, _ in parts))
    width = self._columns.stop - self._columns.start
    self._space: dict[str, Any] = {"size": (env.num_envs, width), "device": env.device, "generator": env.rng}
    low, high, std, scales, replaces = rows = torch.zeros(5, 1, width)
    for where, cfg in parts:
      require(cfg, NoiseCfg, f"expected a NoiseCfg or a NoiseModelCfg, got {described(cfg)}.")
      owner, length = type(cfg).__name__, where.stop - where.start
      check_fields(cfg, owner)
      own = rows[:, 0, where.start - self._columns.start : where.stop - self._columns.start]
      for row, value in zip(own[:3], cfg.distribution(), strict=True):
        row.copy_(per_component(value, length, owner))
      for bounds in own[:2].T.tolist():
        check_value(f"{owner}: bounds", bounds, Range)
      own[3:] = torch.tensor([[cfg.operation == "scale"], [cfg.operation == "abs"]])
    self._low = low.to(env.device)
    # Vectors of zeros need no operation.
    self._span, self._std, self._scales, self._replaces = (
      vector.to(env.device) if vector.any() else None for vector in (high - low, std, scales.bool(), replaces.bool())
    )

  def sample(self) -> torch.Tensor:
    """Return noise of the columns from the first to the last noisy one, (num_envs, W), or (1, W) if it is constant."""
    noise = self._low
    if self._span is not None:
      noise = torch.addcmul(noise, torch.rand(**self._space), self._span)
    if self._std is not None:
      noise = torch.addcmul(noise, torch.randn(**self._space), self._std)
    return noise

  def apply_(self, frame: torch.Tensor) -> None:
    """Apply the noise to `frame`, float32 (num_envs, all columns), in place."""
    x, noise = frame[:, self._columns], self.sample()
    if self._scales is None and self._replaces is None:
      x.add_(noise)
      return
    y = x + noise
    if self._scales is not None:
      y = torch.where(self._scales, x * noise, y)
    if self._replaces is not None:
      y = torch.where(self._replaces, noise, y)
    x.copy_(y)


def per_component(value: PerDim, length: int, owner: str) -> torch.Tensor:
  """Return one number for each component of a term, (length,).

  Raises:
    ConfigError: more or fewer numbers than components.
  """
  numbers = torch.tensor(value, dtype=torch.float32).flatten()
  if len(numbers) not in (1, length):
    raise ConfigError(f"{owner}: {len(numbers)} numbers for {length} components.")
  return numbers.expand(length)
