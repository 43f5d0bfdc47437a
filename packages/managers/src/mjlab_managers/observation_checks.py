"""Checks of the configs of observation groups and terms."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from mjlab_core import Bounds, field_problem

from mjlab_managers.binding import cfg_problems, described
from mjlab_managers.noise import FusedNoise, NoiseCfg, NoiseModelCfg, NoiseModelWithAdditiveBiasCfg
from mjlab_managers.observation_cfg import ObservationGroupCfg, ObservationTermCfg
from mjlab_managers.observation_slots import Slot


def group_problems(group: str, cfg: Any) -> Iterator[str]:
  """Yield the mistakes in a group, apart from those in its terms."""
  problems = cfg_problems(f"group '{group}'", cfg, ObservationGroupCfg)
  yield from problems
  if not problems and not any(term is not None for term in cfg.terms.values()):
    yield f"group '{group}': has no terms. Give it some, or set the group itself to None to leave it out."


def group_term_problems(path: str, cfg: Any) -> Iterator[str]:
  """Yield the mistakes in a term that show without an environment; `path` is "group/term"."""
  if cfg is None:
    return
  problems = cfg_problems(f"term '{path}'", cfg, ObservationTermCfg)
  yield from problems
  if not problems and cfg.delay_min_lag > cfg.delay_max_lag:
    yield f"term '{path}': needs delay_min_lag <= delay_max_lag, got {cfg.delay_min_lag} and {cfg.delay_max_lag}."


def processing_problems(slot: Slot) -> Iterator[str]:
  """Yield the mistakes in clip, scale and noise of a term whose shape is known."""
  cfg = slot.cfg
  if wrong := field_problem(cfg.clip, Bounds | None):
    yield f"term '{slot.path}': clip {wrong}"
  if cfg.scale is not None:
    factors = torch.as_tensor(cfg.scale, dtype=torch.float32).flatten()
    if factors.numel() not in (1, slot.width):
      yield f"term '{slot.path}': {factors.numel()} scales for {slot.width} components."
    elif not factors.isfinite().all():
      yield f"term '{slot.path}': scale must be finite, got {cfg.scale}."
  noise = cfg.noise
  if not slot.group_cfg.corrupt or noise is None or isinstance(noise, NoiseModelCfg):
    return
  biased = noise if isinstance(noise, NoiseModelWithAdditiveBiasCfg) else None
  for part in (noise,) if biased is None else (biased.noise_cfg, biased.bias_noise_cfg):
    if part is None:
      continue
    if not isinstance(part, NoiseCfg):
      yield f"term '{slot.path}': noise: expected a NoiseCfg or a model of noise, got {described(part)}."
      continue
    try:
      FusedNoise([(0, slot.width, part)], "cpu")
    except (TypeError, ValueError) as error:
      yield f"term '{slot.path}': noise: {error}"
