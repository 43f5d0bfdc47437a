"""What a real camera does to its images: exposure, pixel noise, and the noise, steps and holes of depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from mjlab_core.masking import where_
from mjlab_core.sampling import check_range

from mjlab_managers.noise import NoiseModel, NoiseModelCfg

Range = tuple[float, float]


@dataclass(kw_only=True)
class CameraNoiseCfg(NoiseModelCfg):
  """Noise of images (N, channels, height, width), whose colours and depths are shares in [0, 1].

  Each range is one of a camera: every world draws a value at each reset, uniformly, and keeps it for the episode; what
  flickers is drawn anew for every frame. Colours become gain x^gamma + bias, plus noise; depth gets noise, then steps,
  then holes. A depth of 1 is far, or nothing at all, and stays so. Results are held within [0, 1].
  """

  color: tuple[int, ...] = ()
  """Neighbouring channels that are colours."""
  depth: int | None = None
  """The channel that is depth."""
  lost: tuple[int, ...] = ()
  """Neighbouring channels that become 0 in the holes of depth: where depth is valid, masks made from it."""
  gain: Range = (1.0, 1.0)
  """Factor of colours, the time of exposure."""
  gamma: Range = (1.0, 1.0)
  """Exponent of colours; above 1 darkens what is between black and white."""
  bias: Range = (0.0, 0.0)
  """What is added to colours."""
  color_std: Range = (0.0, 0.0)
  """Standard deviation of each frame's noise of colours, a draw for each number of each pixel."""
  depth_std: Range = (0.0, 0.0)
  """Standard deviation of each frame's noise of a depth of 1; it grows with the square of depth, as stereo does."""
  disparity_step: Range = (0.0, 0.0)
  """Depth is rounded so that its inverse is a multiple of this, as stereo does; 0 leaves it as it is."""
  hole_share: Range = (0.0, 0.0)
  """Share of pixels without depth, which read 1; each frame has its own."""
  hole_size: int = 3
  """Edge of the squares that holes are made of [pixel]."""

  def build(
    self, shape: tuple[int, ...], num_envs: int, device: torch.device | str, generator: torch.Generator
  ) -> CameraNoise:
    """The noise of images of one shape (channels, height, width).

    Raises:
      ValueError: no image, a channel that it does not have, channels that are no neighbours, holes of what is no depth,
        or an impossible range.
    """
    return CameraNoise(self, shape, num_envs, device, generator)


_RANGES = ("gain", "gamma", "bias", "color_std", "depth_std", "disparity_step", "hole_share")
_IDLE = {"gain": (1.0, 1.0), "gamma": (1.0, 1.0)}
_SMALLEST = 1e-6


class CameraNoise(NoiseModel):
  """See `CameraNoiseCfg`."""

  _constants = frozenset({"_base", "_width"})

  def __init__(
    self,
    cfg: CameraNoiseCfg,
    shape: tuple[int, ...],
    num_envs: int,
    device: torch.device | str,
    generator: torch.Generator,
  ) -> None:
    if len(shape) != 3:
      raise ValueError(f"CameraNoiseCfg: needs images (channels, height, width), not {shape}.")
    if cfg.hole_size < 1:
      raise ValueError(f"CameraNoiseCfg: hole_size must be at least 1, got {cfg.hole_size}.")
    bounds = {name: getattr(cfg, name) for name in _RANGES}
    for name, (lo, hi) in bounds.items():
      least = float("-inf") if name == "bias" else 0.0
      check_range(f"CameraNoiseCfg: {name}", lo, hi, minimum=least, maximum=1.0 if name == "hole_share" else 1e9)
    self._color, self._lost = _neighbours("color", cfg.color, shape[0]), _neighbours("lost", cfg.lost, shape[0])
    depth = () if cfg.depth is None else (cfg.depth,)
    self._depth = _neighbours("depth", depth, shape[0])
    active = {name for name, bound in bounds.items() if tuple(bound) != _IDLE.get(name, (0.0, 0.0))}
    for name in sorted(active):
      channels = "color" if name in _RANGES[:4] else "depth"
      if getattr(self, f"_{channels}") is None:
        raise ValueError(f"CameraNoiseCfg: {name} changes nothing, for no channel is named as {channels}.")
    self._active = active
    self.num_envs, self._generator, self._size = num_envs, generator, cfg.hole_size
    lo, hi = (torch.tensor([list(end)], device=device) for end in zip(*bounds.values(), strict=True))
    self._base, self._width = lo, hi - lo
    self._drawn = torch.zeros(num_envs, len(_RANGES), device=device)
    self.reset(torch.ones(num_envs, dtype=torch.bool, device=device))

  def reset(self, mask: torch.Tensor) -> None:
    u = torch.rand(self._drawn.shape, generator=self._generator, device=self._drawn.device)
    where_(self._drawn, mask, torch.addcmul(self._base, u, self._width))

  def apply_(self, x: torch.Tensor) -> None:
    gain, gamma, bias, color_std, *of_depth = self._drawn[:, :, None, None, None].unbind(1)
    if self._color is not None:
      color = x[:, self._color]
      y = color.clamp(0.0, 1.0).pow(gamma).mul_(gain).add_(bias)
      if "color_std" in self._active:
        y.addcmul_(self._normal(y), color_std)
      color.copy_(y.clamp_(0.0, 1.0))
    if self._depth is not None:
      self._worsen(x, x[:, self._depth], *of_depth)

  def _worsen(
    self, x: torch.Tensor, depth: torch.Tensor, std: torch.Tensor, step: torch.Tensor, share: torch.Tensor
  ) -> None:
    far, y = depth >= 1.0, depth
    if "depth_std" in self._active:
      y = torch.addcmul(y, self._normal(y) * y.square(), std)
    if "disparity_step" in self._active:
      whole = (1.0 / (y.clamp(min=_SMALLEST) * step.clamp(min=_SMALLEST))).round_().clamp_(min=1.0)
      y = torch.where(step > 0.0, 1.0 / (whole * step.clamp(min=_SMALLEST)), y)
    if "hole_share" in self._active:
      holes = self._holes(depth) < share
      far = far | holes
      if self._lost is not None:
        x[:, self._lost].masked_fill_(holes, 0.0)
    depth.copy_(torch.where(far, 1.0, y.clamp(0.0, 1.0)))

  def _holes(self, like: torch.Tensor) -> torch.Tensor:
    """Uniform numbers that are the same within squares, whose grid is somewhere else in every world, like `like`."""
    size, (n, _, height, width) = self._size, like.shape
    rows, columns = (pixels // size + 2 for pixels in (height, width))
    u = torch.rand(n, rows * columns + 2, generator=self._generator, device=like.device)
    shift = (u[:, -2:] * size).long()
    row = (torch.arange(height, device=like.device) + shift[:, :1]) // size
    column = (torch.arange(width, device=like.device) + shift[:, 1:]) // size
    index = row[:, :, None] * columns + column[:, None, :]
    return u.gather(1, index.flatten(1)).view(n, 1, height, width)

  def _normal(self, like: torch.Tensor) -> torch.Tensor:
    return torch.randn(like.shape, generator=self._generator, device=like.device)


def _neighbours(name: str, channels: Sequence[int], count: int) -> slice | None:
  """The slice that selects channels, so that what is selected is a view; None for none."""
  if not channels:
    return None
  for channel in channels:
    if channel not in range(count):
      raise ValueError(f"CameraNoiseCfg: {name}: channel {channel} does not exist; there are {count}, from 0.")
  first = channels[0]
  if list(channels) != list(range(first, first + len(channels))):
    raise ValueError(f"CameraNoiseCfg: {name}: channels must be neighbours in their order, got {tuple(channels)}.")
  return slice(first, first + len(channels))
