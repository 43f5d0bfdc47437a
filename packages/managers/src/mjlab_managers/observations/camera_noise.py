"""Camera noise: exposure, pixel noise, and the noise, steps and holes of depth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import torch
from mjlab_core import ConfigError, Limits, NonNegativeRange, PositiveCount, Range, as_slice, where_

from mjlab_managers.env import ManagerEnv
from mjlab_managers.observations.noise import NoiseModel, NoiseModelCfg


@dataclass(kw_only=True)
class CameraNoiseCfg(NoiseModelCfg):
  """Noise of images (N, channels, height, width) with colours and depths in [0, 1].

  A range describes the camera: every world draws a uniform value at each reset and keeps it for the episode. Pixel
  noise and holes are drawn for every frame. Colours become gain x^gamma + bias, plus noise. Depth gets noise, then
  steps, then holes. A depth of 1 means far or no measurement, and stays 1. Results are clamped to [0, 1].
  """

  color: tuple[int, ...] = ()
  """Adjacent channels that hold colours."""
  depth: int | None = None
  """Channel that holds depth."""
  lost: tuple[int, ...] = ()
  """Adjacent channels that become 0 in the holes of depth, such as a mask of valid depth."""
  gain: NonNegativeRange = (1.0, 1.0)
  """Factor of colours, as from the exposure time."""
  gamma: NonNegativeRange = (1.0, 1.0)
  """Exponent of colours. A value above 1 darkens the tones between black and white."""
  bias: Range = (0.0, 0.0)
  """Offset of colours."""
  color_std: NonNegativeRange = (0.0, 0.0)
  """Standard deviation of the colour noise, drawn for each channel of each pixel in every frame."""
  depth_std: NonNegativeRange = (0.0, 0.0)
  """Standard deviation of the depth noise at depth 1, drawn in every frame. It grows with the square of depth, as in
  stereo cameras."""
  disparity_step: NonNegativeRange = (0.0, 0.0)
  """Step of the inverse of depth, as in stereo cameras; 0 means no rounding."""
  hole_share: Annotated[NonNegativeRange, Limits(le=1)] = (0.0, 0.0)
  """Share of pixels in holes, which are drawn in every frame. These pixels read 1."""
  hole_size: PositiveCount = 3
  """Edge length of the square holes [pixel]."""

  def build(self, shape: tuple[int, ...], env: ManagerEnv) -> CameraNoise:
    """Return the noise for images of one shape (channels, height, width).

    Raises:
      ValueError: the shape is not that of an image, a channel does not exist, channels are not adjacent, a range needs
        a channel that is not given, or a range is invalid.
    """
    return CameraNoise(self, shape, env)


_RANGES = ("gain", "gamma", "bias", "color_std", "depth_std", "disparity_step", "hole_share")
_IDLE = {"gain": (1.0, 1.0), "gamma": (1.0, 1.0)}
_SMALLEST = 1e-6


class CameraNoise(NoiseModel):
  """Noise of one camera, built by `CameraNoiseCfg`."""

  def __init__(self, cfg: CameraNoiseCfg, shape: tuple[int, ...], env: ManagerEnv) -> None:
    super().__init__(cfg, env)
    bounds = {name: getattr(cfg, name) for name in _RANGES}
    self._active = {name for name, bound in bounds.items() if tuple(bound) != _IDLE.get(name, (0.0, 0.0))}
    channels = {"color": cfg.color, "depth": () if cfg.depth is None else (cfg.depth,), "lost": cfg.lost}
    if problem := _channel_problem(channels, self._active, shape):
      raise ConfigError(f"CameraNoiseCfg: {problem}")
    self._color, self._depth, self._lost = (as_slice(ids) if ids else None for ids in channels.values())
    self._hole_size = cfg.hole_size
    self._bounds = torch.tensor([list(bounds.values())], device=env.device).unbind(-1)
    self._drawn = self.state((len(_RANGES),))
    self.reset(torch.ones(env.num_envs, dtype=torch.bool, device=env.device))

  def reset(self, mask: torch.Tensor) -> None:
    lo, hi = self._bounds
    u = torch.rand(self._drawn.shape, generator=self.rng, device=self.device)
    where_(self._drawn, mask, torch.lerp(lo, hi, u))

  def apply_(self, x: torch.Tensor) -> None:
    gain, gamma, bias, color_std, *depth_noise = self._drawn[:, :, None, None, None].unbind(1)
    if self._color is not None:
      color = x[:, self._color]
      y = color.clamp(0.0, 1.0).pow(gamma).mul_(gain).add_(bias)
      if "color_std" in self._active:
        y.addcmul_(self._normal(y), color_std)
      color.copy_(y.clamp_(0.0, 1.0))
    if self._depth is not None:
      self._worsen(x, x[:, self._depth], *depth_noise)

  def _worsen(
    self, x: torch.Tensor, depth: torch.Tensor, std: torch.Tensor, step: torch.Tensor, share: torch.Tensor
  ) -> None:
    far, y = depth >= 1.0, depth
    if "depth_std" in self._active:
      y = torch.addcmul(y, self._normal(y) * y.square(), std)
    if "disparity_step" in self._active:
      size = step.clamp(min=_SMALLEST)
      whole = (1.0 / (y.clamp(min=_SMALLEST) * size)).round_().clamp_(min=1.0)
      y = torch.where(step > 0.0, 1.0 / (whole * size), y)
    if "hole_share" in self._active:
      holes = self._holes(depth) < share
      far = far | holes
      if self._lost is not None:
        x[:, self._lost].masked_fill_(holes, 0.0)
    depth.copy_(torch.where(far, 1.0, y.clamp(0.0, 1.0)))

  def _holes(self, like: torch.Tensor) -> torch.Tensor:
    """Return uniform numbers in the shape of `like`, constant within squares, on a grid shifted in each world."""
    size, (n, _, height, width) = self._hole_size, like.shape
    rows, columns = (pixels // size + 2 for pixels in (height, width))
    u = torch.rand(n, rows * columns + 2, generator=self.rng, device=like.device)
    shift = (u[:, -2:] * size).long()
    row = (torch.arange(height, device=like.device) + shift[:, :1]) // size
    column = (torch.arange(width, device=like.device) + shift[:, 1:]) // size
    index = row[:, :, None] * columns + column[:, None, :]
    return u.gather(1, index.flatten(1)).view(n, 1, height, width)

  def _normal(self, like: torch.Tensor) -> torch.Tensor:
    return torch.randn(like.shape, generator=self.rng, device=like.device)


def _channel_problem(channels: Mapping[str, Sequence[int]], active: set[str], shape: tuple[int, ...]) -> str:
  """Return the reason why channels do not fit an image, or the active ranges; empty if they do."""
  if len(shape) != 3:
    return f"needs images (channels, height, width), not {shape}."
  for name, ids in channels.items():
    found = as_slice(ids)
    if found is None or not 0 <= found.start <= found.stop <= shape[0]:
      return f"{name}: channels must be neighbours from 0..{shape[0] - 1}, got {tuple(ids)}."
  for name in sorted(active):
    needed = "color" if name in _RANGES[:4] else "depth"
    if not channels[needed]:
      return f"{name} needs {needed}, which names no channel."
  return ""
