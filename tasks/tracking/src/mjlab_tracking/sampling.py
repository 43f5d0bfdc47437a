"""Where episodes start: anywhere, at the beginning of clips, or where the policy fails most."""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from mjlab_core.state import Stateful

from mjlab_tracking.library import MotionLibrary

SamplingMode = Literal["adaptive", "uniform", "start", "each"]
"""Where the policy fails; any moment; the beginning of any clip; world by world the beginning of each clip in turn."""


@dataclass(kw_only=True)
class AdaptiveSamplingCfg:
  """After BeyondMimic (Liao et al., 2025): start more often where, and shortly before where, episodes fail.

  What counts is the rate of failures per visit, not their number: bins that are visited more do not look harder, and
  nothing depends on how many worlds there are.
  """

  uniform_share: float = 0.1
  """Share of starts drawn evenly over all moments."""
  memory: float = 0.001
  """Weight of the present step in the running means of visits and failures."""
  prior: float = 0.1
  """Visits, as a share of an even one, that each bin is credited with at the mean rate of failures."""
  lookahead: int = 3
  """Bins over which failures spread backwards in time, the bin itself included."""
  decay: float = 0.8
  """Weight of each next bin relative to the one before."""

  def problems(self) -> list[str]:
    """What is wrong with these numbers, one sentence each."""
    found = []
    for name in ("uniform_share", "memory", "decay"):
      if not 0.0 < getattr(self, name) <= 1.0:
        found.append(f"adaptive.{name} must be in (0, 1], got {getattr(self, name)}")
    if self.prior <= 0.0:
      found.append(f"adaptive.prior must be positive, got {self.prior}")
    if self.lookahead < 1:
      found.append(f"adaptive.lookahead must be at least 1, got {self.lookahead}")
    return found


class MotionSampler(Stateful):
  """Draws starts from a library and keeps the books of visits and failures by bin and by clip.

  Running means are of shares of worlds per step, so that they do not depend on the number of worlds. All memory is
  fixed, nothing waits for the device.
  """

  _constants = frozenset({"_in_turn"})
  _extra_state = ("visits", "failures", "clip_ends", "clip_failures", "_new")

  def __init__(self, library: MotionLibrary, cfg: AdaptiveSamplingCfg, mode: SamplingMode, num_envs: int) -> None:
    self.library, self.cfg, self.mode, self.num_envs = library, cfg, mode, num_envs
    device = library.table.device

    def zeros(count: int) -> torch.Tensor:
      return torch.zeros(count, device=device)

    bins, clips = library.num_bins, library.num_clips
    self.visits, self.failures = zeros(bins), zeros(bins)
    """Running means of the share of worlds that are in a bin, and that fail in it, in a step, (bins,)."""
    self.clip_ends, self.clip_failures = zeros(clips), zeros(clips)
    """The same of episodes that end in a clip, and of those that fail, (clips,)."""
    self._new = zeros(2 * bins + 2 * clips)
    self._counts = self._new.split((bins, bins, clips, clips))
    self._in_turn = torch.arange(num_envs, device=device) % clips
    weights = torch.tensor([cfg.decay**i for i in range(cfg.lookahead)], device=device)
    self._spread_weights = (weights / weights.sum()).tolist()
    # A bin's successors; the last bin of a clip is its own, so that nothing leaks into the clip before.
    last = (library.bin_offsets + library.bin_counts - 1)[library.clip_of_bin]
    at = torch.arange(bins, device=device)
    self._successors = [torch.minimum(at + i, last) for i in range(cfg.lookahead)]

  def count_ends(self, clip: torch.Tensor, frame: torch.Tensor, ended: torch.Tensor, failed: torch.Tensor) -> None:
    """Notes episodes that end, `failed` among `ended`, bool (N,), at a frame of a clip, int64 (N,) each."""
    ends, fails = ended.float(), (ended & failed).float()
    visits, failures, clip_ends, clip_failures = self._counts
    at = self.library.bin_of(clip, frame)
    visits.index_add_(0, at, ends)
    failures.index_add_(0, at, fails)
    clip_ends.index_add_(0, clip, ends)
    clip_failures.index_add_(0, clip, fails)

  def count_step(self, clip: torch.Tensor, frame: torch.Tensor, moved: torch.Tensor) -> None:
    """Notes a step of the worlds that `moved`, bool (N,), and takes what happened since into the running means.

    Where no world moved, as in a reset by hand, no time has passed: nothing is forgotten, and what ended waits.
    """
    self._counts[0].index_add_(0, self.library.bin_of(clip, frame), moved.float())
    passed = moved.any()
    weight = self.cfg.memory * passed
    for mean, new in zip((self.visits, self.failures, self.clip_ends, self.clip_failures), self._counts, strict=True):
      mean.lerp_(new / self.num_envs, weight)
    self._new.mul_(~passed)

  def failure_rate(self) -> torch.Tensor:
    """Failures per visit of each bin, (bins,); a bin that is hardly visited has about the mean rate of all."""
    visits = self.visits.sum().clamp(min=1e-12)
    credit = self.cfg.prior * visits / self.library.num_bins
    return (self.failures + credit * self.failures.sum() / visits) / (self.visits + credit)

  def probabilities(self) -> torch.Tensor:
    """Probability of each bin to be started in, (bins,)."""
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
    """A clip and a frame of it for every world, int64 (N,) each; after the frame at least one more follows."""
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
    """Values to log, 0-d: how even the starts are, where most are, and each clip's share of starts and of failures."""
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
    """Clip and second at which each bin begins."""
    clips, first = self.library.clip_of_bin.tolist(), self.library.bin_first.tolist()
    return [(self.library.clip_names[c], round(f / self.library.rate)) for c, f in zip(clips, first, strict=True)]


LOGGED_CLIPS = 50
LOGGED_BINS = 100
"""Up to how many clips and bins each has values of its own in the log."""


def _pick(probabilities: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
  """Indices drawn by inverse transform, int64 (N,), from uniform numbers (N,)."""
  edges = torch.cumsum(probabilities, 0)
  index = torch.searchsorted(edges, u * edges[-1], right=True)
  return index.clamp(max=probabilities.numel() - 1)
