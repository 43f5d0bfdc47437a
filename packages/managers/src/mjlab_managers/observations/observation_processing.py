"""Noise, clip, scale and NaN check of all observation terms, compiled into one pass over their columns."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import torch
from mjlab_core import Bounds, DivergedError, Stateful, StatefulDict, check_fields

from mjlab_managers.env import ManagerEnv
from mjlab_managers.observations.noise import FusedNoise, NoiseCfg, NoiseModel, NoiseModelCfg, PerDim, per_component
from mjlab_managers.observations.observation_cfg import ObservationGroupCfg, ObservationTermCfg
from mjlab_managers.terms.binding import Term, placed


@dataclass(kw_only=True, eq=False)
class TermLayout:
  """Term of an observation group: its columns, shapes and processing."""

  group: str
  name: str
  group_cfg: ObservationGroupCfg
  cfg: ObservationTermCfg
  term: Term
  frame_shape: tuple[int, ...]
  """Shape of one frame of one world."""
  history_length: int
  shape: tuple[int, ...]
  """Shape of the observation of one world, history included."""
  columns: slice
  """Columns in the concatenated group."""
  frame: slice
  """Columns in the newest frame of all groups."""
  out: slice
  """Columns in the observations of all groups."""

  @property
  def path(self) -> str:
    """Name of the term in the manager, "group/term"."""
    return f"{self.group}/{self.name}"

  @property
  def width(self) -> int:
    """Number of columns of one frame."""
    return self.frame.stop - self.frame.start

  @property
  def clip(self) -> Bounds | None:
    return self.cfg.clip

  @property
  def scale(self) -> PerDim | None:
    return self.cfg.scale

  @property
  def noise(self) -> Any:
    """Noise of the term, or None if its group is not corrupted."""
    return self.cfg.noise if self.group_cfg.corrupt else None

  def options(self) -> tuple[Any, ...]:
    """Return the live options. A replaced option has another identity."""
    return (self.cfg.noise, self.clip, self.scale, self.group_cfg.corrupt, self.group_cfg.nan_policy)


class Processing(Stateful):
  """Processing of the frame, the columns of all terms side by side, float32 (N, W), with the present options.

  Args:
    slots: the terms and their columns by path.
    env: the environment.
    noting: context that collects the mistakes in the options of a term, by its path.
    before: processing with earlier options. Noise models with the same config keep their state.
  """

  def __init__(
    self,
    slots: Mapping[str, TermLayout],
    env: ManagerEnv,
    noting: Callable[[str], AbstractContextManager[None]],
    before: Processing | None = None,
  ) -> None:
    self.num_envs, self.device = env.num_envs, env.device
    self._env, self._slots = env, slots
    self._options = self._read_options()
    width = sum(slot.width for slot in slots.values())
    counts = torch.zeros(width, dtype=torch.int64, device=self.device) if before is None else before.nonfinite
    self.nonfinite = self.state_of(counts, shared=True)
    """NaN or infinite entries per column since `clear_log`, int64 (W,)."""
    lo, hi, scale, checked = (torch.full((1, width), neutral) for neutral in (-torch.inf, torch.inf, 1.0, True))
    noises: list[tuple[slice, NoiseCfg]] = []
    self._models: StatefulDict[NoiseModel] = StatefulDict()
    earlier = {} if before is None else before._models
    for path, slot in slots.items():
      noise = slot.noise
      with noting(path), placed("while making its noise"):
        if isinstance(noise, NoiseModelCfg):
          check_fields(noise, type(noise).__name__)
          model = earlier.get(path)
          if model is None or model.cfg is not noise:
            model = noise.build(slot.frame_shape, env)
          self._models[path] = model
        elif noise is not None:
          # The noise of all terms is made together; here it is checked.
          FusedNoise([(slot.frame, noise)], env)
          noises.append((slot.frame, noise))
      with noting(path):
        check_fields(slot.cfg, type(slot.cfg).__name__)
        if slot.clip is not None:
          lo[0, slot.frame], hi[0, slot.frame] = slot.clip
        scale[0, slot.frame] = per_component(1.0 if slot.scale is None else slot.scale, slot.width, "scale")
      checked[0, slot.frame] = slot.group_cfg.nan_policy != "disabled"
    self._strict = [slot for slot in slots.values() if slot.group_cfg.nan_policy == "error"]
    self._noise = FusedNoise(noises, env) if noises else None
    # Neutral options need no operation.
    clips = any(slot.clip is not None for slot in slots.values())
    self._lo, self._hi = (lo.to(self.device), hi.to(self.device)) if clips else (None, None)
    self._scale = scale.to(self.device) if (scale != 1.0).any() else None
    self._checked = None if checked.all() else checked.to(self.device)

  def is_current(self) -> bool:
    """Return True if no option was replaced."""
    return all(new is old for new, old in zip(self._read_options(), self._options, strict=True))

  def _read_options(self) -> list[Any]:
    return [option for slot in self._slots.values() for option in slot.options()]

  def redraw(self, mask: torch.Tensor) -> None:
    """Draw the episode noise of the worlds in `mask`, bool (N,)."""
    for model in self._models.values():
      model.reset(mask)

  def apply(self, frame: torch.Tensor, clean: torch.Tensor, advance: torch.Tensor | None) -> None:
    """Process `frame` in place, and write it without NaN and infinite entries into `clean`, both (N, W).

    Entries are counted in the worlds of `advance`, bool (N,); None for all worlds.
    """
    if self._noise is not None:
      self._noise.apply_(frame)
    for path, model in self._models.items():
      slot = self._slots[path]
      model.apply_(frame[:, slot.frame].unflatten(1, slot.frame_shape))
    if self._lo is not None:
      torch.clamp(frame, self._lo, self._hi, out=frame)
    if self._scale is not None:
      frame.mul_(self._scale)
    if self._strict:
      self._env.run_eagerly(
        lambda: self._raise_nonfinite(frame, advance), name="observation check (nan_policy='error')"
      )
    torch.nan_to_num(frame, nan=0.0, posinf=0.0, neginf=0.0, out=clean)
    bad = frame != clean
    if self._checked is not None:
      torch.where(self._checked, clean, frame, out=clean)
      bad &= self._checked
    if advance is not None:
      bad &= advance[:, None]
    self.nonfinite.add_(bad.sum(0))

  def _raise_nonfinite(self, frame: torch.Tensor, advance: torch.Tensor | None) -> None:
    for slot in self._strict:
      bad = ~torch.isfinite(frame[:, slot.frame]).all(1)
      if advance is not None:
        bad &= advance
      worlds = bad.nonzero().flatten().tolist()
      if worlds:
        listed = ", ".join(map(str, worlds[:10])) + (", ..." if len(worlds) > 10 else "")
        raise DivergedError(
          f"ObservationManager: term '{slot.path}' is NaN or infinite in {len(worlds)} worlds: {listed}."
        )
