"""Configs of observations."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Literal, get_args

from mjlab_managers.noise import NoiseCfg, NoiseModelCfg, NoiseModelWithAdditiveBiasCfg
from mjlab_managers.term import ManagerTermBaseCfg

NanPolicy = Literal["sanitize", "disabled", "error"]

NAN_POLICIES: tuple[NanPolicy, ...] = get_args(NanPolicy)


@dataclass
class ObservationTermCfg(ManagerTermBaseCfg):
  """An observation: `func(env, **params)` returns float (N, ...), then processed in the order of the options below."""

  _: KW_ONLY
  noise: NoiseCfg | NoiseModelWithAdditiveBiasCfg | NoiseModelCfg | None = None
  """Applied where the group is corrupted."""
  clip: tuple[float, float] | None = None
  """Smallest and largest value."""
  scale: float | tuple[float, ...] | None = None
  """Factor, for all components or one for each."""
  delay_min_lag: int = 0
  """Smallest delay [env steps]."""
  delay_max_lag: int = 0
  """Largest delay [env steps]."""
  delay_hold_prob: float = 0.0
  """Probability that the delay stays as it was when it is due for a new draw."""
  delay_update_period: int = 0
  """Steps between two draws of the delay; 0 draws every step."""
  delay_per_env: bool = True
  """Whether each world draws its own delay."""
  delay_per_env_phase: bool = True
  """Whether worlds draw at different steps of the period."""
  history_length: int = 0
  """Number of frames shown, oldest first, the newest included; 0 is the newest alone, without a time axis."""
  flatten_history_dim: bool = True
  """Whether a history is (N, H * d) instead of (N, H, d)."""


@dataclass(kw_only=True)
class ObservationGroupCfg:
  """A group of terms that a network takes together."""

  terms: dict[str, ObservationTermCfg | None]
  concatenate_terms: bool = True
  """Whether the group is one tensor (N, D) instead of a dict by term."""
  corrupt: bool = False
  """Whether the terms' noise is applied."""
  history_length: int | None = None
  """If given, the history of every term, together with the group's `flatten_history_dim`."""
  flatten_history_dim: bool = True
  nan_policy: NanPolicy = "sanitize"
  """`sanitize`: NaN and infinite entries become 0 and are counted; `disabled`: they pass; `error`: they raise, for
  which the recorded step is interrupted."""


@dataclass(kw_only=True)
class TermLayout:
  """Where a term is in its group's observation, for whoever rebuilds it elsewhere."""

  name: str
  columns: slice
  """Columns in the concatenated group."""
  shape: tuple[int, ...]
  """Shape of one world's observation, history included."""
  frame_shape: tuple[int, ...]
  """Shape of one frame."""
  history_length: int
  clip: tuple[float, float] | None
  scale: float | tuple[float, ...] | None
