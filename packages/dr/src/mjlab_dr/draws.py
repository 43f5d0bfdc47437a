"""Draws, computed from the values that were written, and their test against the requested distribution."""

from __future__ import annotations

from typing import Any

import torch
from mjlab_core import euler_xyz_from_quat, quat_conjugate, quat_mul
from torch import Tensor

from mjlab_dr.apply import RandomizeField
from mjlab_dr.distributions import Distribution
from mjlab_dr.inertia import inertia_perturbation


def drawn_values(term: RandomizeField) -> dict[str, Tensor]:
  """Return the draws behind the present values, by axis: (num_envs, number of elements), in float64.

  NaN where they cannot be computed: for a direction of unit length, a multiple of zero, an axis that an element does
  not have, or a body without volume.
  """
  field, cfg = term.cfg.row, term.cfg
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
  """Return the p-value of draws under a distribution: near zero if they cannot come from it.

  The two-sample Kolmogorov-Smirnov test of SciPy (the extra `measure`) against `reference` draws; for categories it
  errs towards likely. Values that are not finite are left out; 1 if none is left.
  """
  from scipy.stats import ks_2samp

  drawn = drawn[drawn.isfinite()].flatten().double().cpu()
  if drawn.numel() == 0:
    return 1.0
  generator = torch.Generator().manual_seed(0)
  device = torch.device("cpu")
  asked = distribution.sample((reference,), generator=generator, device=device, dtype=torch.float64)
  # Fields are stored in single precision: numbers that differ in their last bits alone are equal.
  step = 1e-6 * max(drawn.abs().max().item(), asked.abs().max().item(), 1e-12)
  test: Any = ks_2samp((drawn / step).round().numpy(), (asked / step).round().numpy(), method="asymp")
  return float(test.pvalue)


def _inertial(term: RandomizeField, values: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
  """Return mass, centre of mass, moments and axes of every element, of `values` (num_envs, number of components)."""
  e = len(term.element_names)
  mass, com, inertia, quat = values.split([e, 3 * e, 3 * e, 4 * e], dim=1)
  return mass, com.unflatten(1, (e, 3)), inertia.unflatten(1, (e, 3)), quat.unflatten(1, (e, 4))
