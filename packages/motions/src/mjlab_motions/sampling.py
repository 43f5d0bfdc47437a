"""Distribution of episode starts over a library: uniform, first frames, or where the policy fails most."""

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import torch
from mjlab_core.config import Config
from mjlab_core.constraints import Limits, Positive, PositiveCount
from mjlab_core.state import Stateful

from mjlab_motions.library import MotionLibrary

LOGGED_CLIPS, LOGGED_BINS = 50, 100
"""Largest numbers of clips and bins with separate values in the log."""
Share = Annotated[float, Limits(gt=0, le=1)]
SamplingMode = Literal["adaptive", "uniform", "start", "each"]
"""Moments where the policy fails; any moment; the first frame of a random clip; of each clip in turn, by world."""


@dataclass(kw_only=True)
class AdaptiveSamplingCfg(Config):
  """Adaptive sampling after BeyondMimic (Liao et al., 2025): more starts at, and shortly before, frequent failures.

  The measure is failures per visit, so bins with more visits do not look harder, and the number of worlds does not
  matter.
  """

  uniform_share: Share = 0.1
  """Share of starts drawn evenly over all moments."""
  memory: Share = 0.001
  """Weight of the present step in the running means of visits and failures."""
  prior: Positive = 0.1
  """Visits added to each bin at the mean failure rate, as a share of a bin's average number of visits."""
  lookahead: PositiveCount = 3
  """Bins over which failures spread backwards in time, the bin itself included."""
  decay: Share = 0.8
  """Weight of each next bin relative to the one before."""


class MotionSampler(Stateful):
  """Sampler of starts from a library, with counts of visits and failures by bin and by clip.

  Running means are of shares of worlds per step, so they do not depend on the number of worlds. All memory is fixed,
  and nothing waits for the device.
  """

  def __init__(self, library: MotionLibrary, cfg: AdaptiveSamplingCfg, mode: SamplingMode, num_envs: int) -> None:
    self.library, self.cfg, self.mode, self.num_envs = library, cfg, mode, num_envs
    device = self.device = library.table.device

    def zeros(count: int) -> torch.Tensor:
      return self.state((count,), shared=True)

    bins, clips = library.num_bins, library.num_clips
    self.visits, self.failures = zeros(bins), zeros(bins)
    """Running means of the share of worlds that are in a bin, and that fail in it, per step, (bins,)."""
    self.clip_ends, self.clip_failures = zeros(clips), zeros(clips)
    """Running means of the share of worlds whose episode ends in a clip, and fails in it, per step, (clips,)."""
    self._new = zeros(2 * bins + 2 * clips)
    self._counts = self._new.split((bins, bins, clips, clips))
    self._in_turn = torch.arange(num_envs, device=device) % clips
    weights = torch.tensor([cfg.decay**i for i in range(cfg.lookahead)], device=device)
    self._spread_weights = (weights / weights.sum()).tolist()
    # Successors of each bin. The last bin of a clip is its own successor, so nothing leaks into the clip before.
    last = (library.bin_counts.cumsum(0) - 1)[library.clip_of_bin]
    at = torch.arange(bins, device=device)
    self._successors = [torch.minimum(at + i, last) for i in range(cfg.lookahead)]

  def count_ends(self, clip: torch.Tensor, frame: torch.Tensor, ended: torch.Tensor, failed: torch.Tensor) -> None:
    """Count episodes that end, `failed` among `ended`, bool (N,), at a frame of a clip, int64 (N,) each."""
    ends, fails = ended.float(), (ended & failed).float()
    visits, failures, clip_ends, clip_failures = self._counts
    at = self.library.bin_of(clip, frame)
    visits.index_add_(0, at, ends)
    failures.index_add_(0, at, fails)
    clip_ends.index_add_(0, clip, ends)
    clip_failures.index_add_(0, clip, fails)

  def count_step(self, clip: torch.Tensor, frame: torch.Tensor, moved: torch.Tensor) -> None:
    """Count a step of the worlds that `moved`, bool (N,), and update the running means.

    If no world moved, as in a manual reset, no time has passed: the means keep their values, and counts wait.
    """
    self._counts[0].index_add_(0, self.library.bin_of(clip, frame), moved.float())
    passed = moved.any()
    weight = self.cfg.memory * passed
    for mean, new in zip((self.visits, self.failures, self.clip_ends, self.clip_failures), self._counts, strict=True):
      mean.lerp_(new / self.num_envs, weight)
    self._new.mul_(~passed)

  def failure_rate(self) -> torch.Tensor:
    """Return the failures per visit of each bin, (bins,); a rarely visited bin has about the mean rate of all."""
    visits = self.visits.sum().clamp(min=1e-12)
    credit = self.cfg.prior * visits / self.library.num_bins
    return (self.failures + credit * self.failures.sum() / visits) / (self.visits + credit)

  def probabilities(self) -> torch.Tensor:
    """Return the probability of each bin to be the start, (bins,)."""
    share = self.library.bin_share
    if self.mode != "adaptive":
      return share
    rate = self.failure_rate()
    spread = torch.zeros_like(rate)
    for successor, weight in zip(self._successors, self._spread_weights, strict=True):
      spread = spread + weight * rate[successor]
    hard = share * spread
    total = hard.sum()
    known = total > 0.0
    hard = torch.where(known, hard / torch.where(known, total, 1.0), share)
    return self.cfg.uniform_share * share + (1.0 - self.cfg.uniform_share) * hard

  def draw(self, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    """Return a clip and a frame of it for every world, int64 (N,) each; at least one more frame follows."""
    library = self.library
    if self.mode == "each":
      return self._in_turn.clone(), torch.zeros_like(self._in_turn)
    u = torch.rand(2, self.num_envs, generator=generator, device=library.table.device)
    if self.mode == "start":
      clip = _pick(library.clip_share, u[0])
      return clip, torch.zeros_like(clip)
    chosen = _pick(self.probabilities(), u[0])
    first, end = library.bin_first[chosen], library.bin_end[chosen]
    frame = first + (u[1] * (end - first)).long()
    return library.clip_of_bin[chosen], torch.minimum(frame, end - 1)

  def log(self) -> dict[str, torch.Tensor]:
    """Return values to log, 0-d: entropy, most probable bin, and the share of starts and success of each clip."""
    p = self.probabilities()
    top, where = p.max(0)
    bins = max(self.library.num_bins, 2)
    values = {
      "sampling_entropy": -(p * p.clamp(min=1e-12).log()).sum() / math.log(bins),
      "sampling_top_prob": top,
      "sampling_top_bin": where.float() / self.library.num_bins,
    }
    names = self.library.clip_names
    if len(names) <= LOGGED_CLIPS:
      share = torch.zeros_like(self.clip_ends).index_add_(0, self.library.clip_of_bin, p)
      success = 1.0 - self.clip_failures / self.clip_ends
      for i, name in enumerate(names):
        values[f"{name}/start_share"] = share[i]
        values[f"{name}/success"] = success[i]
    if self.library.num_bins <= LOGGED_BINS:
      for i, (name, second) in enumerate(self.bin_labels()):
        values[f"{name}/start_share_{second:03d}s"] = p[i]
    return values

  def bin_labels(self) -> list[tuple[str, int]]:
    """Return the clip and the second at which each bin begins."""
    clips, first = self.library.clip_of_bin.tolist(), self.library.bin_first.tolist()
    return [(self.library.clip_names[c], round(f / self.library.rate)) for c, f in zip(clips, first, strict=True)]


def _pick(probabilities: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
  """Return indices drawn by inverse transform, int64 (N,), from uniform numbers (N,)."""
  edges = torch.cumsum(probabilities, 0)
  index = torch.searchsorted(edges, u * edges[-1], right=True)
  return index.clamp(max=probabilities.numel() - 1)
