"""Configs of observations."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Literal

from mjlab_core import Bounds, Config, Count, Share

from mjlab_managers.observations.noise import NoiseCfg, NoiseModelCfg, PerDim
from mjlab_managers.terms.term import ManagerTermBaseCfg

NanPolicy = Literal["sanitize", "warn", "disabled", "error"]


@dataclass
class ObservationTermCfg(ManagerTermBaseCfg):
  """Config of an observation term: `func(env, **params)` returns float (N, ...).

  The value is processed in the order of the fields below.
  """

  _: KW_ONLY
  noise: NoiseCfg | NoiseModelCfg | None = None
  """Noise, applied in groups with `corrupt=True`."""
  clip: Bounds | None = None
  """Smallest and largest value."""
  scale: PerDim | None = None
  """Factor for all components, or one for each."""
  delay_min_lag: Count = 0
  """Smallest delay [env steps]."""
  delay_max_lag: Count = 0
  """Largest delay [env steps]."""
  delay_hold_prob: Share = 0.0
  """Probability that a world keeps its delay at a draw."""
  delay_update_period: Count = 0
  """Steps between two draws of the delay; 0 draws in every step."""
  delay_per_env: bool = True
  """True: each world draws its own delay; False: one draw for all worlds."""
  delay_per_env_phase: bool = True
  """True: worlds draw at different steps of the period."""
  history_length: Count = 0
  """Number of frames H, oldest first, the newest included; 0 gives the newest frame without a time axis."""
  flatten_history_dim: bool = True
  """True: a history is (N, H * d); False: (N, H, d)."""
  source: str | None = None
  """Name of a reading that supplies the value outside the simulation; None uses the source that `func` declares."""


@dataclass(kw_only=True)
class ObservationGroupCfg(Config):
  """Config of a group of terms, one input of a network."""

  terms: dict[str, ObservationTermCfg | None]
  concatenate_terms: bool = True
  """True: the group is one tensor, (N, D); False: a dict of terms."""
  corrupt: bool = False
  """True: the noise of the terms is applied."""
  history_length: Count | None = None
  """Number of frames of every term, used with `flatten_history_dim` of the group; None uses those of the terms."""
  flatten_history_dim: bool = True
  nan_policy: NanPolicy = "sanitize"
  """Treatment of NaN and infinite entries.

  `sanitize` replaces them by 0 and counts them. `warn` also names the term in the logger "mjlab" once per log interval.
  `disabled` passes them on. `error` raises, and interrupts the recorded step for the check."""
