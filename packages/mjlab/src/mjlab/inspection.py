"""Measured effect of each event: it fires once in many worlds and is compared with its config."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import torch
from mjlab_core.tables import table
from mjlab_dr import FIELDS, Distribution, RandomizeField, agreement, drawn_values
from mjlab_envs import mdp

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

_STATE = ("qpos", "qvel", "act", "ctrl", "xfrc_applied", "qfrc_applied", "mocap_pos", "mocap_quat", "eq_active")
_UNLIKELY = 1e-4


@dataclass(kw_only=True)
class AxisReport:
  """One axis of one randomised field, all of its elements together."""

  field: str
  axis: str
  unit: str
  elements: tuple[str, ...]
  operation: str
  asked: Distribution
  drawn: torch.Tensor
  """Drawn values, finite ones only, (number of draws,)."""
  probability: float
  """Probability of draws like these if they follow `asked`."""
  values: torch.Tensor
  """Values written for this axis, (num_envs, number of elements)."""
  compiled: torch.Tensor
  """Values before the event, (1 or num_envs, number of elements)."""

  @property
  def verdict(self) -> str:
    """In words: as asked, or what is wrong."""
    lo, hi = self.asked.support()
    if self.values.numel() and not (self.values - self.compiled).any():
      return "NOTHING CHANGES"
    if self.values.numel() and not (self.values - self.values[:1]).any() and lo != hi:
      return "NOTHING DIFFERS"
    return "as asked" if self.probability > _UNLIKELY else "NOT AS ASKED"


@dataclass(kw_only=True)
class EventReport:
  """Effect of one event."""

  name: str
  mode: str
  axes: list[AxisReport] = field(default_factory=list)
  changed: dict[str, torch.Tensor] = field(default_factory=dict)
  """Of an event without distributions: the numbers that it changed, (num_envs, how many), by what they belong to."""
  params: dict[str, Any] = field(default_factory=dict)
  """Parameters of such an event."""


@dataclass(kw_only=True)
class InertiaReport:
  """Mass of every entity, and shape of the bodies whose inertia differs between worlds."""

  masses: dict[str, torch.Tensor]
  """Total mass by entity, (num_envs,) [kg]."""
  compiled: dict[str, float]
  """The same as compiled."""
  bodies: dict[str, tuple[torch.Tensor, torch.Tensor, torch.Tensor]]
  """Centre of mass, principal moments and axes by body, (num_envs + 1, 3 or 4); the first is as compiled."""


def inspect_events(env: "ManagerBasedRlEnv") -> list[EventReport]:
  """Fire every event of an environment in all worlds, one after the other, at full strength.

  The environment is used up by it: its state is whatever the events made of it.
  """
  env.reset()
  actions = torch.zeros(env.num_envs, env.action_manager.total_action_dim, device=env.device)
  for _ in range(3):
    # So that there is something to reset.
    env.step(actions.uniform_(-1.0, 1.0))
  reports = []
  manager = env.event_manager
  for name in manager.active_terms:
    cfg = manager.get_term_cfg(name)
    report = EventReport(name=name, mode=cfg.mode)
    reports.append(report)
    if isinstance(cfg.func, mdp.randomize):
      term = cfg.func.field
      if not FIELDS[term.cfg.field].integer:
        term.strength.fill_(1.0)
      manager.fire(name)
      report.axes = _axes(term)
      continue
    before = _snapshot(env)
    manager.fire(name)
    report.params = dict(cfg.params)
    for what, now in _snapshot(env).items():
      flat = now.reshape(len(now), -1)
      old = before.get(what)
      kept = torch.ones_like(flat[0], dtype=torch.bool) if old is None else (flat != old.reshape(flat.shape)).any(0)
      if kept.any():
        report.changed[what] = flat[:, kept]
  return reports


def _snapshot(env: "ManagerBasedRlEnv") -> dict[str, torch.Tensor]:
  """All that an event may have changed, by name: state, model fields that differ between worlds, actuators, sensors."""
  found = {name: value for name in _STATE if (value := getattr(env.sim.data, name)).numel()}
  found |= {name: env.sim.model[name] for name in env.sim.expanded_fields if name in FIELDS}
  return {name: value.detach().clone() for name, value in (found | _tensors(env.scene.state_dict())).items()}


def _tensors(state: Any, path: str = "") -> dict[str, torch.Tensor]:
  """Return the tensors of a nested state by their path."""
  if isinstance(state, torch.Tensor):
    return {path: state} if state.dim() and state.numel() else {}
  items = state.items() if isinstance(state, Mapping) else enumerate(state) if isinstance(state, list | tuple) else ()
  found: dict[str, torch.Tensor] = {}
  for key, value in items:
    found |= _tensors(value, f"{path}.{key}" if path else str(key))
  return found


def inspect_inertia(env: "ManagerBasedRlEnv") -> InertiaReport:
  """Masses and inertias of an environment's worlds as they are."""
  sim = env.sim
  report = InertiaReport(masses={}, compiled={}, bodies={})
  fields = ("body_mass", "body_ipos", "body_inertia", "body_iquat")
  default = {name: sim.default_field(name)[:1] for name in fields}
  now = {name: sim.model[name].expand(env.num_envs, *default[name].shape[1:]) for name in fields}
  for name, entity in env.scene.entities.items():
    ids = entity.indexing.ids["body"].tolist()
    mass = now["body_mass"][:, ids].sum(-1)
    if not mass.any():
      continue
    report.masses[name], report.compiled[name] = mass, float(default["body_mass"][0, ids].sum())
    for body, local in zip(ids, entity.indexing.names["body"], strict=True):
      if any((now[part][:, body] != default[part][:, body]).any() for part in fields):
        rows = [torch.cat([default[part][:, body], now[part][:, body]]) for part in fields]
        mass, com, moments, quat = rows
        report.bodies[f"{name}/{local}"] = com, moments / mass[:, None].clamp_min(1e-12), quat
  return report


def _axes(term: RandomizeField) -> list[AxisReport]:
  cfg, info = term.cfg, FIELDS[term.cfg.field]
  values, compiled, reports = term.values(), term.default, []
  for (name, drawn), (axis, asked) in zip(drawn_values(term).items(), term.distributions.items(), strict=True):
    columns = [i for i, c in enumerate(term.components) if c.axis == name and c.field == cfg.shown_in]
    finite = drawn[drawn.isfinite()]
    # One draw for all elements is one draw.
    sample = drawn[:, :1] if cfg.shared else drawn
    reports.append(
      AxisReport(
        field=cfg.field,
        axis=name,
        unit="1" if cfg.operation == "scale" else info.unit_of(axis),
        elements=tuple(term.element_names),
        operation=cfg.operation,
        asked=asked,
        drawn=finite,
        probability=agreement(sample, asked),
        values=values[:, columns] if columns else values,
        compiled=compiled[:, columns] if columns else compiled,
      )
    )
  return reports


def report_text(reports: list[EventReport], inertia: InertiaReport) -> str:
  """Return the reports as text."""
  head = ("event", "mode", "changes", "of", "asked", "drawn: least", "mean", "most", "verdict")
  rows: list[tuple[str, ...]] = []
  for report in reports:
    lead = (report.name, report.mode)
    if not report.axes and not report.changed:
      rows.append((*lead, "-", "", "", "", "", "", "NOTHING CHANGED"))
    for what, values in report.changed.items():
      differs = "differs between worlds" if (values != values[:1]).any() else "same in all worlds"
      rows.append((*lead, what, str(values.shape[1]), _given(report.params), *_span(values), differs))
      lead = ("", "")
    for axis in report.axes:
      what = f"{axis.field} {axis.axis}".strip()
      rows.append((*lead, what, _listed(axis.elements), _asked(axis), *_span(axis.drawn), axis.verdict))
      lead = ("", "")
  lines = [table(head, rows)]
  for name, mass in inertia.masses.items():
    lines.append(
      f"total mass of {name}: {mass.min():.4g} to {mass.max():.4g} kg, mean {mass.mean():.4g}; "
      f"as compiled {inertia.compiled[name]:.4g}"
    )
  return "\n".join(lines)


def _span(values: torch.Tensor) -> list[str]:
  """Return least, mean and greatest of the finite values."""
  found = values[values.isfinite()].double()
  return [f"{x:.4g}" for x in (found.min(), found.mean(), found.max())] if found.numel() else ["-"] * 3


def _given(params: Mapping[str, Any]) -> str:
  """Return the numbers among the parameters of an event, such as ranges."""

  def shown(value: Any) -> str:
    if isinstance(value, Mapping):
      return ", ".join(f"{key} {text}" for key, item in value.items() if (text := shown(item)))
    if isinstance(value, tuple | list) and value and all(isinstance(item, float | int) for item in value):
      return " to ".join(f"{item:g}" for item in value)
    return f"{value:g}" if isinstance(value, float | int) else ""

  texts = {name: shown(value) for name, value in params.items()}
  return "; ".join(f"{name}: {text}" for name, text in texts.items() if text) or "as written"


def _asked(axis: AxisReport) -> str:
  parameters: dict[str, Any] = getattr(axis.asked, "__dict__", {})
  numbers = ", ".join(f"{value:g}" if isinstance(value, float | int) else str(value) for value in parameters.values())
  return f"{axis.operation} {type(axis.asked).__name__}({numbers})"


def _listed(names: tuple[str, ...]) -> str:
  return names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"
