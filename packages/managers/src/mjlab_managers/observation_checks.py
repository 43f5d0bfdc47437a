"""Checks of the configs of observation groups and terms."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import torch
from mjlab_core.constraints import why_no_count
from mjlab_core.names import unknown
from mjlab_core.sampling import check_bounds

from mjlab_managers.binding import term_problems
from mjlab_managers.manager import described
from mjlab_managers.noise import EpisodeBias, FusedNoise, NoiseCfg, NoiseModelCfg, NoiseModelWithAdditiveBiasCfg
from mjlab_managers.observation_cfg import NAN_POLICIES, ObservationGroupCfg, ObservationTermCfg
from mjlab_managers.observation_slots import Slot


def group_problems(group: str, cfg: Any) -> Iterator[str]:
  """Yield the mistakes in a group, apart from those in its terms."""
  if not isinstance(cfg, ObservationGroupCfg):
    yield f"group '{group}': expected an ObservationGroupCfg, got {described(cfg)}."
    return
  if cfg.nan_policy not in NAN_POLICIES:
    yield unknown("nan_policy", str(cfg.nan_policy), NAN_POLICIES, owner=f"group '{group}'")
  if cfg.history_length is not None and (wrong := why_no_count(cfg.history_length)):
    yield f"group '{group}': history_length {wrong}."
  if not isinstance(cfg.terms, Mapping):
    yield f"group '{group}': terms must be a dict by name, got {described(cfg.terms)}."
  elif not any(term is not None for term in cfg.terms.values()):
    yield f"group '{group}': has no terms. Give it some, or set the group itself to None to leave it out."


def group_term_problems(path: str, cfg: Any) -> Iterator[str]:
  """Yield the mistakes in a term that show without an environment; `path` is "group/term"."""
  if cfg is None:
    return
  if not isinstance(cfg, ObservationTermCfg):
    yield f"term '{path}': expected an ObservationTermCfg, got {described(cfg)}."
    return
  for problem in term_problems(cfg):
    yield f"term '{path}': {problem}"
  counts = ("delay_min_lag", "delay_max_lag", "delay_update_period", "history_length")
  wrong = [f"term '{path}': {name} {why}." for name in counts if (why := why_no_count(getattr(cfg, name)))]
  yield from wrong
  if not wrong and cfg.delay_min_lag > cfg.delay_max_lag:
    yield f"term '{path}': needs delay_min_lag <= delay_max_lag, got {cfg.delay_min_lag} and {cfg.delay_max_lag}."
  if not 0.0 <= cfg.delay_hold_prob <= 1.0:
    yield f"term '{path}': delay_hold_prob must be in [0, 1], got {cfg.delay_hold_prob}."


def processing_problems(slot: Slot) -> Iterator[str]:
  """Yield the mistakes in clip, scale and noise of a term whose shape is known."""
  cfg = slot.cfg
  if cfg.clip is not None:
    try:
      check_bounds(f"term '{slot.path}': clip", cfg.clip)
    except ValueError as error:
      yield str(error)
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
  try:
    for part in (noise,) if biased is None else (biased.noise_cfg, biased.bias_noise_cfg):
      if part is not None and not isinstance(part, NoiseCfg):
        raise TypeError(f"expected a NoiseCfg or a model of noise, got {described(part)}.")
      if part is not None:
        FusedNoise([(0, slot.width, part)], "cpu")
    if biased is not None:
      EpisodeBias([(0, slot.width, biased)], torch.zeros(1, slot.width), torch.Generator())
  except (AttributeError, TypeError, ValueError) as error:
    yield f"term '{slot.path}': noise: {error}"
