"""Observations: what the policy and the critic see."""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping
from typing import Any

import torch
from mjlab_core.buffers import DelayBuffer, HistoryBuffer
from mjlab_core.counts import why_no_count
from mjlab_core.masking import where_
from mjlab_core.names import UnknownNameError, unknown
from mjlab_core.sampling import check_bounds
from mjlab_core.state import Stateful

from mjlab_managers.binding import Term, copy_cfg
from mjlab_managers.env import ManagerEnv
from mjlab_managers.manager import ManagerBase, described, is_float
from mjlab_managers.noise import (
  EpisodeBias,
  FusedNoise,
  NoiseCfg,
  NoiseModel,
  NoiseModelCfg,
  NoiseModelWithAdditiveBiasCfg,
)
from mjlab_managers.observation_cfg import NAN_POLICIES, ObservationGroupCfg, ObservationTermCfg, TermLayout
from mjlab_managers.observation_slots import Slot, delay_columns, place_columns, twin_of
from mjlab_managers.table import table


class NonfiniteObservationError(RuntimeError):
  """An observation of a group with `nan_policy="error"` is NaN or infinite."""


Observation = torch.Tensor | dict[str, torch.Tensor]


class ObservationManager(ManagerBase[ObservationGroupCfg]):
  """Evaluates every distinct term once and processes all groups as the columns of one frame.

  Noise, clip, scale and the check for NaN work on the whole frame, whatever the number of terms. Delays and histories
  follow on their columns. The result lies in one block; `buffers` are views into it.
  """

  cfg_type = ObservationGroupCfg
  _constants = frozenset({"_frame", "_clean", "_lo", "_hi", "_scale", "_checked", "_permutation", "_nonfinite"})
  _children = ("_models", "_delays", "_histories")

  def __init__(self, cfgs: Mapping[str, ObservationGroupCfg | None], env: ManagerEnv) -> None:
    super().__init__(cfgs, env)
    self._slots: list[Slot] = []
    for group, cfg in self._cfgs.items():
      self._read_group(group, cfg)
    self._raise_problems()

    place_columns(self._slots)
    frame_width = self._slots[-1].frame.stop if self._slots else 0
    out_width = self._slots[-1].out.stop if self._slots else 0
    self._frame = torch.zeros(self.num_envs, frame_width, device=self.device)
    self._clean = torch.zeros_like(self._frame)
    self._out = torch.zeros(self.num_envs, out_width, device=self.device)
    self._bias = torch.zeros_like(self._frame)
    self._nonfinite = torch.zeros(frame_width, dtype=torch.int64, device=self.device)
    self._biases: list[tuple[int, int, NoiseModelWithAdditiveBiasCfg]] = []
    self._episode_bias: EpisodeBias | None = None
    self._models: dict[str, NoiseModel] = {}
    self._built_from: dict[str, NoiseModelCfg] = {}
    self._compile_processing()
    self._raise_problems()
    self._build_delays()
    self._build_histories()
    self._simple = not (self._delays or self._histories)

    self.buffers: dict[str, Observation] = {group: self._view(group) for group in self.active_groups}
    """Each group's observation, float32 (N, D) or a dict of terms; always the same memory."""

  # Build.

  def _read_group(self, group: str, cfg: ObservationGroupCfg) -> None:
    if cfg.nan_policy not in NAN_POLICIES:
      self._problem(unknown("nan_policy", str(cfg.nan_policy), NAN_POLICIES, owner=f"group '{group}'"))
    if cfg.history_length is not None and (wrong := why_no_count(cfg.history_length)):
      self._problem(f"group '{group}': history_length {wrong}.")
      return
    first = len(self._slots)
    for name, term_cfg in cfg.terms.items():
      if term_cfg is None:
        continue
      if not isinstance(term_cfg, ObservationTermCfg):
        self._problem(f"term '{group}/{name}': expected an ObservationTermCfg, got {type(term_cfg).__name__}.")
        continue
      own = copy_cfg(term_cfg)
      cfg.terms[name] = own
      if self._check_term(f"{group}/{name}", own):
        self._read_term(group, name, own, cfg)
    slots = self._slots[first:]
    if cfg.concatenate_terms and len(slots) > 1:
      for slot in slots:
        if len(slot.out_shape) > 1:
          self._problem(
            f"term '{slot.path}': shape {slot.out_shape} cannot be concatenated; flatten it, or set "
            f"concatenate_terms=False on group '{group}'."
          )

  def _check_term(self, path: str, cfg: ObservationTermCfg) -> bool:
    before = len(self._problems)
    try:
      if cfg.clip is not None:
        check_bounds(f"term '{path}': clip", cfg.clip)
    except ValueError as error:
      self._problem(str(error), error)
    for option in ("delay_min_lag", "delay_max_lag", "delay_update_period", "history_length"):
      if wrong := why_no_count(getattr(cfg, option)):
        self._problem(f"term '{path}': {option} {wrong}.")
    if len(self._problems) == before and cfg.delay_min_lag > cfg.delay_max_lag:
      self._problem(
        f"term '{path}': needs delay_min_lag <= delay_max_lag, got {cfg.delay_min_lag} and {cfg.delay_max_lag}."
      )
    if not 0.0 <= cfg.delay_hold_prob <= 1.0:
      self._problem(f"term '{path}': delay_hold_prob must be in [0, 1], got {cfg.delay_hold_prob}.")
    return len(self._problems) == before

  def _read_term(self, group: str, name: str, cfg: ObservationTermCfg, group_cfg: ObservationGroupCfg) -> None:
    path = f"{group}/{name}"
    own = self._bind(path, cfg)
    if own is None:
      return
    before = len(self._problems)
    twin = twin_of(own, self._slots)
    if twin is not None:
      shape = twin.shape
    else:
      value = self._dry_run(own)
      what = f"float ({self.num_envs}, ...)"
      if len(self._problems) > before or not self._check_tensor(path, value, what, is_float):
        return
      if value.dim() < 2 or value.shape[0] != self.num_envs:
        self._problem(f"term '{path}': must return {what} with at least two dimensions, returned {tuple(value.shape)}.")
        return
      shape = tuple(value.shape[1:])
    history, flatten = cfg.history_length, cfg.flatten_history_dim
    if group_cfg.history_length is not None:
      history, flatten = group_cfg.history_length, group_cfg.flatten_history_dim
    term = own if twin is None else twin.term
    self._slots.append(Slot(group, name, group_cfg, cfg, own, term, shape, history, flatten))

  def _compile_processing(self) -> None:
    """Turns noise, clip, scale and NaN policies into vectors over the frame."""
    width = self._frame.shape[1]
    lo, hi = torch.full((1, width), -math.inf), torch.full((1, width), math.inf)
    scale = torch.ones(1, width)
    checked = torch.zeros(1, width, dtype=torch.bool)
    self._strict: list[Slot] = []
    noises: list[tuple[int, int, NoiseCfg]] = []
    biases: list[tuple[int, int, NoiseModelWithAdditiveBiasCfg]] = []
    models: dict[str, tuple[Slot, NoiseModelCfg]] = {}
    for slot in self._slots:
      cfg, columns = slot.cfg, slot.frame
      group = slot.group_cfg
      if cfg.clip is not None:
        lo[0, columns], hi[0, columns] = cfg.clip
      if cfg.scale is not None:
        factors = torch.as_tensor(cfg.scale, dtype=torch.float32).cpu().flatten()
        if factors.numel() not in (1, slot.width):
          self._problem(f"term '{slot.path}': {factors.numel()} scales for {slot.width} components.")
          continue
        if not factors.isfinite().all():
          self._problem(f"term '{slot.path}': scale must be finite, got {cfg.scale}.")
          continue
        scale[0, columns] = factors
      checked[0, columns] = group.nan_policy != "disabled"
      if group.nan_policy == "error":
        self._strict.append(slot)
      if not group.corrupt or cfg.noise is None:
        continue
      if isinstance(cfg.noise, NoiseModelCfg):
        models[slot.path] = slot, cfg.noise
        continue
      bias = cfg.noise if isinstance(cfg.noise, NoiseModelWithAdditiveBiasCfg) else None
      noise = cfg.noise.noise_cfg if isinstance(cfg.noise, NoiseModelWithAdditiveBiasCfg) else cfg.noise
      try:
        for part in (noise, bias.bias_noise_cfg if bias is not None else None):
          if part is not None and not isinstance(part, NoiseCfg):
            raise TypeError(f"expected a NoiseCfg or a model of noise, got {described(part)}.")
          if part is not None:
            FusedNoise([(0, slot.width, part)], "cpu")
      except (AttributeError, TypeError, ValueError) as error:
        self._problem(f"term '{slot.path}': noise: {error}", error)
        continue
      if noise is not None:
        noises.append((columns.start, columns.stop, noise))
      if bias is not None:
        biases.append((columns.start, columns.stop, bias))
    if self._problems:
      return
    self._build_models(models)
    if self._problems:
      return
    self._noise = FusedNoise(noises, self.device) if noises else None
    if biases != self._biases:
      self._biases = biases
      try:
        self._episode_bias = EpisodeBias(biases, self._bias.zero_(), self.env.rng) if biases else None
      except ValueError as error:
        self._problem(f"noise: {error}", error)
        return
      if self._episode_bias is not None:
        self._episode_bias.redraw(torch.ones(self.num_envs, dtype=torch.bool, device=self.device))
    clips = bool(torch.isfinite(lo).any() or torch.isfinite(hi).any())
    self._lo, self._hi = (lo.to(self.device), hi.to(self.device)) if clips else (None, None)
    self._scale = scale.to(self.device) if (scale != 1.0).any() else None
    self._checks = bool(checked.any())
    self._checked = None if checked.all() else checked.to(self.device)
    self._processing = [slot.processing() for slot in self._slots]
    self._terms = list(dict.fromkeys(slot.term for slot in self._slots))

  def _build_models(self, wanted: Mapping[str, tuple[Slot, NoiseModelCfg]]) -> None:
    """Builds the noise that has a model; one whose config is the same goes on with what it remembers."""
    models: dict[str, NoiseModel] = {}
    for path, (slot, cfg) in wanted.items():
      if path in self._models and self._built_from[path] is cfg:
        models[path] = self._models[path]
        continue
      try:
        models[path] = cfg.build(slot.shape, self.num_envs, self.device, self.env.rng)
      except (TypeError, ValueError) as error:
        self._problem(f"term '{path}': noise: {error}", error)
    if not self._problems:
      self._models, self._built_from = models, {path: cfg for path, (_, cfg) in wanted.items()}
      self._modelled = [(models[path], slot.frame, slot.shape) for path, (slot, _) in wanted.items()]

  def _build_delays(self) -> None:
    self._delays: dict[str, DelayBuffer] = {}
    self._delay_columns = delay_columns(self._slots)
    by_path = {slot.path: slot.cfg for slot in self._slots}
    for key, columns in self._delay_columns.items():
      cfg = by_path[key]
      self._delays[key] = DelayBuffer(
        cfg.delay_min_lag,
        cfg.delay_max_lag,
        self.num_envs,
        (columns.stop - columns.start,),
        self.device,
        torch.float32,
        self.env.rng,
        cfg.delay_hold_prob,
        cfg.delay_update_period,
        per_env=cfg.delay_per_env,
        per_env_phase=cfg.delay_per_env_phase,
      )

  def _build_histories(self) -> None:
    """One window per length; and where each output column is in [frame, window, window, ...]."""
    lengths = sorted({slot.history for slot in self._slots if slot.remembers})
    self._histories: dict[str, HistoryBuffer] = {}
    self._history_columns: dict[str, slice | torch.Tensor] = {}
    source: list[int] = []
    offsets: dict[int, int] = {}
    widths: dict[int, int] = {}
    position: dict[str, int] = {}
    offset = self._frame.shape[1]
    for length in lengths:
      columns: list[int] = []
      for slot in self._slots:
        if slot.history == length and slot.remembers:
          position[slot.path] = len(columns)
          columns += range(slot.frame.start, slot.frame.stop)
      contiguous = columns == list(range(columns[0], columns[-1] + 1))
      index = slice(columns[0], columns[-1] + 1) if contiguous else torch.tensor(columns, device=self.device)
      self._history_columns[str(length)] = index
      self._histories[str(length)] = HistoryBuffer(length, self.num_envs, (len(columns),), self.device, torch.float32)
      offsets[length], widths[length] = offset, len(columns)
      offset += length * len(columns)
    for slot in self._slots:
      if slot.remembers:
        for age in range(slot.history):
          first = offsets[slot.history] + age * widths[slot.history] + position[slot.path]
          source += range(first, first + slot.width)
      else:
        source += range(slot.frame.start, slot.frame.stop)
    self._permutation = torch.tensor(source, dtype=torch.int64, device=self.device) if lengths else None

  def _view(self, group: str) -> Observation:
    slots = self._group_slots(group)
    if not self._cfgs[group].concatenate_terms:
      return {slot.name: self._out[:, slot.out].unflatten(1, slot.out_shape) for slot in slots}
    columns = self._out[:, slots[0].out.start : slots[-1].out.stop]
    return columns.unflatten(1, slots[0].out_shape) if len(slots) == 1 else columns

  # What the user asks.

  @property
  def active_groups(self) -> list[str]:
    """Names of the groups that have terms, in order."""
    return list(dict.fromkeys(slot.group for slot in self._slots))

  @property
  def active_terms(self) -> dict[str, list[str]]:
    """Names of the terms of each group, in order."""
    return {group: [slot.name for slot in self._group_slots(group)] for group in self.active_groups}

  @property
  def group_obs_dim(self) -> dict[str, tuple[int, ...] | list[tuple[int, ...]]]:
    """Shape of one world's observation by group; a list of shapes where terms are not concatenated."""
    return {
      group: tuple(view.shape[1:]) if isinstance(view, torch.Tensor) else [tuple(v.shape[1:]) for v in view.values()]
      for group, view in self.buffers.items()
    }

  @property
  def group_obs_term_dim(self) -> dict[str, list[tuple[int, ...]]]:
    """Shape of one world's terms by group."""
    return {group: [slot.out_shape for slot in self._group_slots(group)] for group in self.active_groups}

  @property
  def group_obs_concatenate(self) -> dict[str, bool]:
    """Whether each group is one tensor."""
    return {group: self._cfgs[group].concatenate_terms for group in self.active_groups}

  @property
  def nonfinite_counts(self) -> dict[str, torch.Tensor]:
    """Entries that were NaN or infinite since `clear_log` by "group/term", int64, 0-d."""
    return {slot.path: self._nonfinite[slot.frame].sum() for slot in self._slots}

  def layout(self, group: str) -> list[TermLayout]:
    """Where each term of a group is and how it was processed."""
    self._lookup({name: name for name in self.active_groups}, group)
    slots = self._group_slots(group)
    start = slots[0].out.start
    return [
      TermLayout(
        name=slot.name,
        columns=slice(slot.out.start - start, slot.out.stop - start),
        shape=slot.out_shape,
        frame_shape=slot.shape,
        history_length=slot.history,
        clip=slot.cfg.clip,
        scale=slot.cfg.scale,
      )
      for slot in slots
    ]

  def get_term_cfg(self, group: str, name: str | None = None, /) -> Any:
    """The live config of a term, or of a group if no term is named.

    Parameters, noise, clip, scale, `corrupt` and `nan_policy` may be replaced on the host; the rest is fixed at build.

    Raises:
      UnknownNameError: no such group or term.
    """
    cfg = self._lookup(self._cfgs, group)
    if name is None:
      return cfg
    terms = {key: term for key, term in cfg.terms.items() if term is not None}
    if name not in terms:
      raise UnknownNameError(unknown("term", name, list(terms), owner=f"{self.label}: group '{group}'"))
    return terms[name]

  def get(self) -> dict[str, Observation]:
    """The observations of the last `compute`; nothing advances."""
    return self.buffers

  # What the environment calls.

  def compute(self, fresh: torch.Tensor | None = None, advance: torch.Tensor | None = None) -> dict[str, Observation]:
    """Observes, and moves delays and histories on by one frame.

    Args:
      fresh: worlds that were just reset, bool (N,): their delay lines and windows are filled with the new frame.
      advance: if given, only these worlds, all of them fresh, are observed: bool (N,). The observations, delays and
        histories of the others stay bit-identical.

    Returns:
      `buffers`.
    """
    if not self._slots:
      return self.buffers
    frame = self._frame
    torch.cat(self._evaluate(advance), dim=1, out=frame)
    if self._noise is not None:
      self._noise.apply_(frame, self.env.rng)
    if self._episode_bias is not None:
      self._episode_bias.add_to(frame)
    for model, columns, shape in self._modelled:
      model.apply_(frame[:, columns].unflatten(1, shape))
    if self._lo is not None:
      torch.clamp(frame, self._lo, self._hi, out=frame)
    if self._scale is not None:
      frame.mul_(self._scale)
    clean = self._out if self._simple and advance is None else self._clean
    self._remove_nonfinite(frame, clean, advance)

    for key, delay in self._delays.items():
      columns = clean[:, self._delay_columns[key]]
      if advance is not None:
        delay.fill(advance, columns)
        continue
      if fresh is not None:
        delay.reset(fresh)
      columns.copy_(delay.push(columns))
    final = clean
    if self._permutation is not None:
      blocks = [clean]
      for key, history in self._histories.items():
        columns = clean[:, self._history_columns[key]]
        if advance is not None:
          history.fill(advance, columns)
        else:
          if fresh is not None:
            history.reset(fresh)
          history.append(columns)
        blocks.append(history.read().flatten(1))
      final = torch.cat(blocks, dim=1).index_select(1, self._permutation)
    if advance is not None:
      where_(self._out, advance, final)
    elif final is not self._out:
      self._out.copy_(final)
    return self.buffers

  def _evaluate(self, advance: torch.Tensor | None) -> list[torch.Tensor]:
    raw: dict[Term, torch.Tensor] = {}
    for term in self._terms:
      func: Any = term.func
      before = func.state_dict() if advance is not None and isinstance(func, Stateful) else None
      value = term()
      raw[term] = value if value.dim() == 2 else value.flatten(1)
      if before is not None:
        # What a term remembers of the other worlds must not advance with these.
        assert advance is not None
        func.take_back(before, advance)
    return [raw[slot.term] for slot in self._slots]

  def _remove_nonfinite(self, frame: torch.Tensor, clean: torch.Tensor, advance: torch.Tensor | None) -> None:
    if not self._checks:
      clean.copy_(frame)
      return
    if self._strict:
      self.env.run_eagerly(lambda: self._raise_nonfinite(advance), name="observation check (nan_policy='error')")
    torch.nan_to_num(frame, nan=0.0, posinf=0.0, neginf=0.0, out=clean)
    if self._checked is not None:
      torch.where(self._checked, clean, frame, out=clean)
    bad = frame != clean
    if self._checked is not None:
      bad &= self._checked
    if advance is not None:
      bad &= advance[:, None]
    self._nonfinite.add_(bad.sum(0))

  def _raise_nonfinite(self, advance: torch.Tensor | None) -> None:
    for slot in self._strict:
      bad = ~torch.isfinite(self._frame[:, slot.frame]).all(1)
      if advance is not None:
        bad &= advance
      worlds = bad.nonzero().flatten().tolist()
      if worlds:
        listed = ", ".join(map(str, worlds[:10])) + (", ..." if len(worlds) > 10 else "")
        raise NonfiniteObservationError(
          f"{self.label}: term '{slot.path}' is NaN or infinite in {len(worlds)} worlds: {listed}."
        )

  def reset(self, mask: torch.Tensor) -> None:
    """Draws anew what noise keeps for an episode in the worlds of `mask`, bool (N,), and resets class terms there.

    Delays and histories are filled by the `compute` that gets these worlds as `fresh`.
    """
    if self._episode_bias is not None:
      self._episode_bias.redraw(mask)
    for model, *_ in self._modelled:
      model.reset(mask)
    super().reset(mask)

  def sync(self) -> None:
    """Host side, before each step: takes over what was replaced in the live configs."""
    changed = [slot for slot in self._slots if slot.own.params_changed()]
    if changed:
      for index, slot in enumerate(self._slots):
        twin = twin_of(slot.own, self._slots[:index])
        slot.term = slot.own if twin is None else twin.term
    replaced = [
      slot
      for slot, old in zip(self._slots, self._processing, strict=True)
      if not all(map(operator.is_, slot.processing(), old))
    ]
    if changed or replaced:
      self._compile_processing()
      self._raise_problems()
      names = ", ".join(slot.path for slot in [*changed, *replaced])
      self.env.request_recapture(f"{self.label}: configuration of {names} changed")

  def log_tensors(self) -> tuple[list[str], torch.Tensor]:
    """`Nonfinite/observation/<group>/<term>`: NaN or infinite entries since `clear_log`; NaN where there were none."""
    names = [f"Nonfinite/observation/{slot.path}" for slot in self._slots]
    if not names:
      return super().log_tensors()
    counts = torch.stack([count.double() for count in self.nonfinite_counts.values()])
    return names, counts.masked_fill(counts == 0, torch.nan)

  def clear_log(self) -> None:
    self._nonfinite.zero_()

  def terms(self, env_idx: int) -> list[tuple[str, list[float]]]:
    row = self._out[env_idx].tolist()
    return [(slot.path, row[slot.out]) for slot in self._slots]

  def describe(self) -> str:
    rows = []
    for slot in self._slots:
      cfg, group = slot.cfg, self._cfgs[slot.group]
      noise = type(cfg.noise).__name__ if group.corrupt and cfg.noise is not None else ""
      lag = f"{cfg.delay_min_lag} to {cfg.delay_max_lag}" if cfg.delay_max_lag else ""
      optional = ["" if value is None else value for value in (cfg.clip, cfg.scale)]
      rows.append((slot.group, slot.name, slot.out_shape, noise, *optional, lag, slot.history or ""))
    columns = ("group", "term", "shape", "noise", "clip", "scale", "delay", "history")
    return table("Observations", columns, rows)

  def _group_slots(self, group: str) -> list[Slot]:
    return [slot for slot in self._slots if slot.group == group]
