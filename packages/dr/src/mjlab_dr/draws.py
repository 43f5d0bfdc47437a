"""What was drawn, told from what was written, and whether it is what was asked for."""

from __future__ import annotations

import torch
from mjlab_core import euler_xyz_from_quat, quat_conjugate, quat_mul
from torch import Tensor

from mjlab_dr.apply import RandomizeField
from mjlab_dr.catalogue import FIELDS
from mjlab_dr.distributions import Distribution
from mjlab_dr.inertia import inertia_perturbation


def drawn_values(term: RandomizeField) -> dict[str, Tensor]:
  """What the worlds as they are now were drawn with, by axis: (num_envs, number of elements), in float64.

  NaN where it cannot be told: a direction after it was given unit length, a multiple of zero, an axis that an element
  does not have, or a body without volume.
  """
  field, cfg = FIELDS[term.cfg.field], term.cfg
  values, default = term.values().double(), term.default.double()
  n, names = values.shape[0], [field.axes[axis] for axis in cfg.values]
  if field.form == "pseudo_inertia":
    before, after = (_inertial(term, x) for x in (default.expand(n, -1), values))
    found = inertia_perturbation(*before, *after)
    return {name: found[..., axis] for name, axis in zip(names, cfg.values, strict=True)}
  if field.form == "rotation":
    turn = quat_mul(values.unflatten(1, (-1, 4)), quat_conjugate(default.unflatten(1, (-1, 4))).expand(n, -1, -1))
    angles = euler_xyz_from_quat(turn)
    return {name: angles[axis] for name, axis in zip(names, cfg.values, strict=True)}
  out = torch.full((n, len(term.element_names), len(names)), torch.nan, dtype=torch.float64, device=values.device)
  if field.form != "direction":
    if cfg.operation == "add":
      values = values - default
    elif cfg.operation == "scale":
      values = torch.where(default == 0.0, torch.nan, values / default)
    for i, component in enumerate(term.components):
      if component.field == cfg.shown_in and component.axis in names:
        out[:, term.element_names.index(component.element), names.index(component.axis)] = values[:, i]
  return dict(zip(names, out.unbind(-1), strict=True))


def agreement(drawn: Tensor, distribution: Distribution, *, reference: int = 20_000) -> float:
  """How likely draws as far from a distribution as these are, if they are its own; near zero if they are not.

  The two-sample Kolmogorov-Smirnov test against `reference` draws (of categories, which have steps, it errs towards
  likely). Values that are not finite are left out; 1 if none is left.
  """
  drawn = drawn[drawn.isfinite()].flatten().double().cpu().sort().values
  if drawn.numel() == 0:
    return 1.0
  generator = torch.Generator().manual_seed(0)
  device = torch.device("cpu")
  asked = distribution.sample((reference,), generator=generator, device=device, dtype=torch.float64).sort().values
  places = torch.cat((drawn, asked))
  # Fields are stored in single precision: equal numbers may differ in their last bits.
  slack = 1e-6 * places.abs().max().clamp_min(1e-12)
  below = [torch.searchsorted(x, places + slack, right=True) / x.numel() for x in (drawn, asked)]
  distance = (below[0] - below[1]).abs().max().item()
  effective = drawn.numel() * reference / (drawn.numel() + reference)
  z = (effective**0.5 + 0.12 + 0.11 / effective**0.5) * distance
  if z < 0.2:
    return 1.0
  terms = torch.arange(1, 101, dtype=torch.float64)
  series = 2.0 * ((-1.0) ** (terms - 1.0) * torch.exp(-2.0 * terms.square() * z * z)).sum()
  return float(series.clamp(0.0, 1.0))


def _inertial(term: RandomizeField, values: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
  """Mass, centre of mass, moments and axes of every element, of `values` (num_envs, number of components)."""
  e = len(term.element_names)
  mass, com, inertia, quat = values.split([e, 3 * e, 3 * e, 4 * e], dim=1)
  return mass, com.unflatten(1, (e, 3)), inertia.unflatten(1, (e, 3)), quat.unflatten(1, (e, 4))
