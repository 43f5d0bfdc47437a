"""Every row of the catalogue: what is drawn, what stays, and what derives from it."""

import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from mjlab_core import euler_xyz_from_quat, quat_conjugate, quat_mul
from mjlab_dr import FIELDS, Categorical, Randomization, inertia_perturbation, randomize
from scipy import stats

# The tests share a module.
sys.path.insert(0, str(Path(__file__).parent))

from dr_everything import EVERYTHING, check_numbers, numbers, owner_of, recompiled, trial, written_by

WORLDS = 300
SPEC_MODEL = mujoco.MjModel.from_xml_string(EVERYTHING)
# The tree of bounding boxes, its margins and the scale of sleep are MuJoCo's own engine's.
ENGINE_ONLY = {"bvh_aabb", "body_margin", "dof_length"}
# Rows of actuator models need some.
each_row = pytest.mark.parametrize("name", [name for name in FIELDS if FIELDS[name].kind != "target"])


def compiled(name: str, model: mujoco.MjModel = SPEC_MODEL) -> np.ndarray:
  if name == "encoder_bias":
    return np.zeros(model.njnt)
  return np.asarray(getattr(owner_of(model, name), name.removeprefix("opt.")))


def draws(name: str, fields: dict[str, torch.Tensor]) -> dict[str, np.ndarray]:
  """What was drawn, by axis, in all worlds and elements, seen from what was written."""
  field, cfg = FIELDS[name], trial(name)
  value = fields[written_by(name)[0]].double()
  default = torch.tensor(compiled(written_by(name)[0]), dtype=torch.float64)
  if field.form == "pseudo_inertia":
    moving = [i for i in range(SPEC_MODEL.nbody) if SPEC_MODEL.body_weldid[i] and SPEC_MODEL.body_mass[i]]
    before = [torch.tensor(compiled(part)[moving]) for part in field.fields]
    after = [fields[part][:, moving] for part in field.fields]
    found = inertia_perturbation(*[x.expand(y.shape) for x, y in zip(before, after, strict=True)], *after)
    return {axis: found[..., i].numpy().ravel() for i, axis in enumerate(field.axes)}
  if field.form == "rotation":
    changed = (value != default).flatten(2).any(-1).any(0)
    turn = quat_mul(value[:, changed], quat_conjugate(default[changed]).expand_as(value[:, changed]))
    return {axis: x.numpy().ravel() for axis, x in zip(field.axes, euler_xyz_from_quat(turn), strict=True)}
  if field.form == "servo":
    value, default = value[..., 0], default[:, 0]
  if cfg.operation == "add":
    value = value - default
  elif cfg.operation == "scale":
    value = torch.where(default == 0.0, torch.nan, value / default)
  changed = (value != value[:1]).any(0) & ~value.isnan().any(0)
  if len(field.axes) == 1 or field.kind == "option":
    changed = changed.unsqueeze(-1) if len(field.axes) == 1 else changed
    value = value.unsqueeze(-1) if len(field.axes) == 1 else value
  return {axis: value[..., i][:, changed[..., i]].numpy().ravel() for i, axis in enumerate(field.axes)}


@each_row
def test_draws_have_the_asked_distribution_in_every_world_and_the_rest_is_bit_identical(name: str) -> None:
  cfg, field = trial(name), FIELDS[name]
  fields = randomize(SPEC_MODEL, [cfg], num_worlds=WORLDS, seed=5, dtype=torch.float64)
  for part in written_by(name):
    assert fields[part].reshape(WORLDS, -1).unique(dim=0).shape[0] >= min(WORLDS, 2 if field.integer else WORLDS), part
  if field.form == "direction":
    # Its components are no longer what was drawn.
    np.testing.assert_allclose(fields[name].norm(dim=-1), 1.0, rtol=1e-12)
  else:
    found = draws(name, fields)
    for axis, distribution in cfg.values.items():
      sample = found[field.axes[axis]]
      if isinstance(distribution, Categorical):
        weights = np.array(distribution.weights or [1.0] * len(distribution.values))
        counts = np.unique(sample, return_counts=True)[1]
        assert stats.chisquare(counts, weights / weights.sum() * counts.sum()).pvalue > 1e-3
      elif cfg.every_axis and not len(sample):
        continue
      else:
        lo, hi = distribution.support()
        # Degrees of freedom of one joint share a draw, so that one of each is looked at.
        assert stats.kstest(np.unique(sample), stats.uniform(lo, hi - lo).cdf).pvalue > 1e-3, field.axes[axis]
  # Elements without effect keep every bit; in eq_data, the rest follows from what was written.
  once = Randomization(mujoco.MjModel.from_xml_string(EVERYTHING), [cfg], seed=0)
  written = {key for term in once._terms for key in term.claims}
  for part in set(written_by(name)) - {"eq_data"}:
    flat, default = fields[part].reshape(WORLDS, -1), torch.tensor(compiled(part)).flatten()
    others = [i for i in range(flat.shape[1]) if (part, i) not in written]
    assert torch.equal(flat[:, others], default[others].to(flat.dtype).expand(WORLDS, -1)), part


@pytest.mark.parametrize("name", [name for name in FIELDS if FIELDS[name].in_model])
def test_every_world_is_the_model_recompiled_with_its_values(name: str) -> None:
  fields = randomize(SPEC_MODEL, [trial(name)], num_worlds=2, seed=1, dtype=torch.float64)
  for world in range(2):
    drawn = {part: value[world].numpy() for part, value in fields.items()}
    oracle = numbers(recompiled({part: drawn[part] for part in written_by(name)}))
    check_numbers(numbers(SPEC_MODEL) | drawn, {part: oracle[part] for part in oracle.keys() - ENGINE_ONLY})


@each_row
def test_repeats_on_one_model_do_not_drift(name: str) -> None:
  model = mujoco.MjModel.from_xml_string(EVERYTHING)
  once = randomize(model, [trial(name)], seed=2)
  first = once.changes()
  for _ in range(5):
    once.resample()
  once.resample(2)
  assert once.changes() == first
  once.restore()
  restored = numbers(model)
  for other, value in numbers(SPEC_MODEL).items():
    assert np.array_equal(restored[other], value), other
