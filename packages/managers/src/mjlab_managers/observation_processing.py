"""Noise, clip, scale and NaN check of all observation terms, compiled into one pass over their columns."""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence
from typing import Any

import torch
from mjlab_core import DivergedError, Stateful, StatefulDict

from mjlab_managers.env import ManagerEnv
from mjlab_managers.noise import (
  EpisodeBias,
  FusedNoise,
  NoiseCfg,
  NoiseModel,
  NoiseModelCfg,
  NoiseModelWithAdditiveBiasCfg,
)
from mjlab_managers.observation_checks import processing_problems
from mjlab_managers.observation_slots import Slot


class Processing(Stateful):
  """Processing of the frame, the columns of all terms side by side, float32 (N, W).

  Args:
    slots: the terms and their columns.
    width: columns of the frame.
    env: the environment.
  """

  def __init__(self, slots: Sequence[Slot], width: int, env: ManagerEnv) -> None:
    self.num_envs, self.device = env.num_envs, env.device
    self._env, self._slots, self._width = env, slots, width
    # Redrawn at resets by `redraw`, not refilled.
    self._bias = self.state_of(torch.zeros(self.num_envs, width, device=self.device))
    self._models: StatefulDict[NoiseModel] = StatefulDict()
    self._built_from: dict[str, NoiseModelCfg] = {}
    self._bias_parts: list[tuple[int, int, NoiseModelWithAdditiveBiasCfg]] = []
    self._episode_bias: EpisodeBias | None = None
    self.nonfinite = torch.zeros(width, dtype=torch.int64, device=self.device)
    """NaN or infinite entries per column since `clear_log`, int64 (W,)."""
    self._compiled: list[tuple[Any, ...]] = []
    self.problems = self.compile()

  def is_current(self) -> bool:
    """Return True if no config was replaced since `compile`."""
    now = [slot.processing() for slot in self._slots]
    return len(now) == len(self._compiled) and all(
      all(map(operator.is_, new, old)) for new, old in zip(now, self._compiled, strict=True)
    )

  def compile(self) -> list[str]:
    """Read the configs and return the mistakes in them. With mistakes, nothing changes."""
    if problems := [problem for slot in self._slots for problem in processing_problems(slot)]:
      return problems
    lo, hi = torch.full((1, self._width), -math.inf), torch.full((1, self._width), math.inf)
    scale = torch.ones(1, self._width)
    checked = torch.zeros(1, self._width, dtype=torch.bool)
    noises: list[tuple[int, int, NoiseCfg]] = []
    biases: list[tuple[int, int, NoiseModelWithAdditiveBiasCfg]] = []
    modelled: list[tuple[Slot, NoiseModelCfg]] = []
    for slot in self._slots:
      cfg, columns = slot.cfg, slot.frame
      if cfg.clip is not None:
        lo[0, columns], hi[0, columns] = cfg.clip
      if cfg.scale is not None:
        scale[0, columns] = torch.as_tensor(cfg.scale, dtype=torch.float32).cpu().flatten()
      checked[0, columns] = slot.group_cfg.nan_policy != "disabled"
      noise = cfg.noise if slot.group_cfg.corrupt else None
      if isinstance(noise, NoiseModelCfg):
        modelled.append((slot, noise))
      elif isinstance(noise, NoiseModelWithAdditiveBiasCfg):
        biases.append((columns.start, columns.stop, noise))
        if noise.noise_cfg is not None:
          noises.append((columns.start, columns.stop, noise.noise_cfg))
      elif noise is not None:
        noises.append((columns.start, columns.stop, noise))
    if problems := self._build_models(modelled):
      return problems
    self._strict = [slot for slot in self._slots if slot.group_cfg.nan_policy == "error"]
    self._noise = FusedNoise(noises, self.device) if noises else None
    if biases != self._bias_parts:
      self._bias_parts = biases
      self._episode_bias = EpisodeBias(biases, self._bias.zero_(), self._env.rng) if biases else None
      if self._episode_bias is not None:
        self._episode_bias.redraw(torch.ones(self.num_envs, dtype=torch.bool, device=self.device))
    clips = bool(torch.isfinite(lo).any() or torch.isfinite(hi).any())
    self._lo, self._hi = (lo.to(self.device), hi.to(self.device)) if clips else (None, None)
    self._scale = scale.to(self.device) if (scale != 1.0).any() else None
    self._checks = bool(checked.any())
    self._checked = None if checked.all() else checked.to(self.device)
    self._compiled = [slot.processing() for slot in self._slots]
    return []

  def _build_models(self, wanted: Sequence[tuple[Slot, NoiseModelCfg]]) -> list[str]:
    """Build the noise models and return mistakes. A model with an unchanged config keeps its state."""
    models: dict[str, NoiseModel] = {}
    problems: list[str] = []
    for slot, cfg in wanted:
      if self._built_from.get(slot.path) is cfg:
        models[slot.path] = self._models[slot.path]
        continue
      try:
        models[slot.path] = cfg.build(slot.shape, self.num_envs, self.device, self._env.rng)
      except (TypeError, ValueError) as error:
        problems.append(f"term '{slot.path}': noise: {error}")
    if not problems:
      self._models = StatefulDict(models)
      self._built_from = {slot.path: cfg for slot, cfg in wanted}
      self._modelled = [(models[slot.path], slot.frame, slot.shape) for slot, _ in wanted]
    return problems

  def redraw(self, mask: torch.Tensor) -> None:
    """Draw the episode noise of the worlds in `mask`, bool (N,)."""
    if self._episode_bias is not None:
      self._episode_bias.redraw(mask)
    for model, *_ in self._modelled:
      model.reset(mask)

  def apply(self, frame: torch.Tensor, clean: torch.Tensor, advance: torch.Tensor | None) -> None:
    """Process `frame` in place, and write it without NaN and infinite entries into `clean`, both (N, W).

    Entries are counted in the worlds of `advance`, bool (N,); None for all worlds.
    """
    if self._noise is not None:
      self._noise.apply_(frame, self._env.rng)
    if self._episode_bias is not None:
      self._episode_bias.add_to(frame)
    for model, columns, shape in self._modelled:
      model.apply_(frame[:, columns].unflatten(1, shape))
    if self._lo is not None:
      torch.clamp(frame, self._lo, self._hi, out=frame)
    if self._scale is not None:
      frame.mul_(self._scale)
    if not self._checks:
      clean.copy_(frame)
      return
    if self._strict:
      self._env.run_eagerly(
        lambda: self._raise_nonfinite(frame, advance), name="observation check (nan_policy='error')"
      )
    torch.nan_to_num(frame, nan=0.0, posinf=0.0, neginf=0.0, out=clean)
    if self._checked is not None:
      torch.where(self._checked, clean, frame, out=clean)
    bad = frame != clean
    if self._checked is not None:
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
