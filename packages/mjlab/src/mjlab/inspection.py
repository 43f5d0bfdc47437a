"""Measured effect of each event: it fires once in many worlds and is compared with its config."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch
from mjlab_core.io.tables import table
from mjlab_dr import FIELDS, Distribution, RandomizeField, agreement, drawn_values
from mjlab_envs import mdp
from mjlab_managers import EventTermCfg

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

_STATE = ("qpos", "qvel", "act", "ctrl", "xfrc_applied", "qfrc_applied", "mocap_pos", "mocap_quat", "eq_active")
_UNLIKELY = 1e-4


@dataclass(kw_only=True)
class AxisReport:
  """Axis of a randomised field, or quantity that an event without distributions changed."""

  field: str
  """Name of the field, and of the axis if the field has several; name of the quantity."""
  elements: str
  """Names of the elements that a field has the axis of; count of the numbers of a quantity."""
  asked: str
  """Operation and distribution; parameters of an event without distributions."""
  drawn: torch.Tensor
  """Drawn or written values, finite ones only, (number of values,)."""
  verdict: str
  """Either "as asked" or the problem in capitals; a description for an event without distributions."""
  distribution: Distribution | None = None
  """None for an event without distributions."""
  label: str = ""
  """Meaning and unit of a draw."""


@dataclass(kw_only=True)
class EventReport:
  """Effect of one event."""

  name: str
  mode: str
  axes: list[AxisReport]


@dataclass(kw_only=True)
class InertiaReport:
  """Masses of entities, and inertias of bodies that differ between worlds; the first row of each is as compiled."""

  masses: dict[str, torch.Tensor]
  """Total mass by entity, (num_envs + 1,) [kg]."""
  bodies: dict[str, tuple[torch.Tensor, torch.Tensor, torch.Tensor]]
  """Centre of mass, principal moments per mass and their axes by body, (num_envs + 1, 3 or 4)."""


def inspect_events(env: "ManagerBasedRlEnv") -> list[EventReport]:
  """Fire every event of an environment in all worlds, one after the other, at full strength.

  The environment keeps the state that the events leave.
  """
  env.reset()
  actions = torch.zeros(env.num_envs, env.action_manager.total_action_dim, device=env.device)
  for _ in range(3):
    # Events of mode reset need a state other than the initial one.
    env.step(actions.uniform_(-1.0, 1.0))
  manager = env.event_manager
  return [_fired(env, name, manager.get_term_cfg(name)) for name in manager.active_terms]


def _fired(env: "ManagerBasedRlEnv", name: str, cfg: EventTermCfg) -> EventReport:
  """Fire an event and return its effect."""
  if isinstance(cfg.func, mdp.randomize):
    term = cfg.func.field
    if not FIELDS[term.cfg.field].integer:
      term.strength.fill_(1.0)
    env.event_manager.fire(name)
    return EventReport(name=name, mode=cfg.mode, axes=_axes(term))
  before = _snapshot(env)
  env.event_manager.fire(name)
  report = EventReport(name=name, mode=cfg.mode, axes=[])
  for what, now in _snapshot(env).items():
    is_other = now != before[what] if what in before else torch.ones_like(now, dtype=torch.bool)
    kept = is_other.reshape(len(now), -1).any(0)
    if kept.any():
      values = now.reshape(len(now), -1)[:, kept]
      differs = "differs between worlds" if (values != values[:1]).any() else "same in all worlds"
      axis = AxisReport(
        field=what,
        elements=str(values.shape[1]),
        asked=_given(cfg.params),
        drawn=values[values.isfinite()],
        verdict=differs,
      )
      report.axes.append(axis)
  return report


def _snapshot(env: "ManagerBasedRlEnv") -> dict[str, torch.Tensor]:
  """Return all quantities that an event can change: state, model fields of each world, actuators and sensors."""
  found = {name: value for name in _STATE if (value := getattr(env.sim.data, name)).numel()}
  found |= {name: env.sim.model[name] for name in env.sim.expanded_fields if name in FIELDS}
  return {name: value.detach().clone() for name, value in (found | _tensors(env.scene.state_dict())).items()}


def _tensors(state: Mapping[str, Any], path: str = "") -> dict[str, torch.Tensor]:
  """Return the tensors of a nested state by their path."""
  found: dict[str, torch.Tensor] = {}
  for name, value in state.items():
    if isinstance(value, Mapping):
      found |= _tensors(value, f"{path}{name}.")
    elif isinstance(value, torch.Tensor) and value.dim() and value.numel():
      found[f"{path}{name}"] = value
  return found


def inspect_inertia(env: "ManagerBasedRlEnv") -> InertiaReport:
  """Return masses and inertias of an environment's worlds as they are."""
  sim = env.sim
  report = InertiaReport(masses={}, bodies={})
  fields = ("body_mass", "body_ipos", "body_inertia", "body_iquat")
  stacked = []
  for name in fields:
    compiled = sim.default_field(name)[:1]
    # Worlds that share a field have one row.
    stacked.append(torch.cat((compiled, sim.model[name].expand(env.num_envs, *compiled.shape[1:]))))
  mass, com, moments, quat = stacked
  for name, entity in env.scene.entities.items():
    ids = entity.indexing.ids["body"].tolist()
    if not mass[1:, ids].any():
      continue
    report.masses[name] = mass[:, ids].sum(-1)
    for body, local in zip(ids, entity.indexing.names["body"], strict=True):
      if any((rows[:, body] != rows[:1, body]).any() for rows in stacked):
        per_mass = moments[:, body] / mass[:, body, None].clamp_min(1e-12)
        report.bodies[f"{name}/{local}"] = com[:, body], per_mass, quat[:, body]
  return report


def _axes(term: RandomizeField) -> list[AxisReport]:
  cfg, (first, *others) = term.cfg, term.element_names
  values, default, reports = term.values(), term.default, []
  more = f" and {len(others)} more" if others else ""
  meaning = {"add": "added", "scale": "factor", "absolute": "value"}[cfg.operation]
  for (name, drawn), (axis, asked) in zip(drawn_values(term).items(), term.distributions.items(), strict=True):
    columns = [i for i, c in enumerate(term.components) if c.axis == name and c.field == cfg.shown_in]
    columns = columns or list(range(values.shape[1]))
    # One draw for all elements is one draw.
    sample = drawn[:, :1] if cfg.shared else drawn
    reports.append(
      AxisReport(
        field=f"{cfg.field} {name}".strip(),
        elements=f"{first}{more}",
        asked=f"{cfg.operation} {asked}",
        drawn=drawn[drawn.isfinite()],
        verdict=_verdict(sample, asked, values[:, columns], default[:, columns]),
        distribution=asked,
        label=f"{meaning} [{'1' if cfg.operation == 'scale' else FIELDS[cfg.field].unit_of(axis)}]",
      )
    )
  return reports


def _verdict(drawn: torch.Tensor, asked: Distribution, values: torch.Tensor, default: torch.Tensor) -> str:
  """Return whether draws are as asked, from the values of an axis before and after the event."""
  lo, hi = asked.support()
  if values.numel() and torch.equal(values, default.expand_as(values)):
    return "NOTHING CHANGES"
  if values.numel() and lo != hi and not (values != values[:1]).any():
    return "NOTHING DIFFERS"
  return "as asked" if agreement(drawn, asked) > _UNLIKELY else "NOT AS ASKED"


def report_text(reports: list[EventReport], inertia: InertiaReport) -> str:
  """Return the reports as text."""
  head = ("event", "mode", "changes", "of", "asked", "drawn: least", "mean", "most", "verdict")
  rows: list[tuple[str, ...]] = []
  for report in reports:
    lead = (report.name, report.mode)
    if not report.axes:
      rows.append((*lead, "-", "", "", "", "", "", "NOTHING CHANGED"))
    for axis in report.axes:
      drawn = axis.drawn.double()
      span = [f"{x:.4g}" for x in (drawn.min(), drawn.mean(), drawn.max())] if drawn.numel() else ["-"] * 3
      rows.append((*lead, axis.field, axis.elements, axis.asked, *span, axis.verdict))
  lines = [table(head, rows)]
  for name, masses in inertia.masses.items():
    compiled, mass = masses[0], masses[1:]
    span = f"{mass.min():.4g} to {mass.max():.4g} kg, mean {mass.mean():.4g}"
    lines.append(f"total mass of {name}: {span}; as compiled {compiled:.4g}")
  return "\n".join(lines)


def _given(params: Mapping[str, Any]) -> str:
  """Return the numbers among the parameters of an event, such as ranges."""
  kinds = (float, int, tuple, list, Mapping)
  return "; ".join(f"{name}: {value}" for name, value in params.items() if isinstance(value, kinds)) or "as written"
