"""Every row of the catalogue that can be fitted comes back from an overlay file as it was fitted."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from dr_everything import EVERYTHING, trial
from mjlab_core import MjlabError
from mjlab_dr import FIELDS
from mjlab_scene import read_overlay
from mjlab_sysid import FitTerm, parse_term, robot_on_ground
from mjlab_sysid.worlds import Worlds

# Rows of actuator models are written into their configs, which a test of `sysid` covers.
NOT_IN_THE_MODEL = ("stiffness", "damping", "effort_limit", "delay", "encoder_bias")


def can_be_fitted(name: str) -> bool:
  try:
    parse_term(f"{name}:.*")
  except MjlabError:
    return False
  return name not in NOT_IN_THE_MODEL


# Rows whose axes or elements cannot all change by the same range.
NARROW = {
  "opt.wind": "opt.wind.x:option=0.5..1.5",
  "opt.magnetic": "opt.magnetic.y:option=-0.7..-0.4",
  "jnt_range": "jnt_range.upper:hip=1.3..1.5",
  "geom_size": "geom_size.size1:.*",
  "tendon_lengthspring": "tendon_lengthspring.upper:rope=0.31..0.4",
  "actuator_gainprm": "actuator_gainprm.0:hip=31..35",
  "actuator_biasprm": "actuator_biasprm.1:hip=-35..-31",
  "actuator_dynprm": "actuator_dynprm.0:rope=0.03..0.04",
  "actuator_gear": "actuator_gear.0:hip|rope",
  "eq_data": "eq_data.0:.*=0.2..0.4",
}


def term(name: str) -> FitTerm:
  """A term of all elements of a row, with the bounds of a randomiser of it."""
  if name in NARROW or name == "pseudo_inertia":
    return parse_term(NARROW.get(name, f"{name}:.*"))
  cfg = trial(name)
  return FitTerm(field=name, pattern=".*", range=(cfg.operation, *next(iter(cfg.values.values())).support()))


@pytest.mark.parametrize("name", [name for name in FIELDS if can_be_fitted(name)])
def test_fitted_numbers_are_in_the_model_with_the_overlay(name: str, tmp_path: Path) -> None:
  spec = mujoco.MjSpec.from_string(EVERYTHING)
  worlds = Worlds(robot_on_ground(spec, (), floor=None), 1)
  parameters = worlds.bind([term(name)], {})
  random = np.random.default_rng(0)
  numbers = np.array([random.uniform(p.lo, p.hi) for p in parameters])
  content = worlds.overlay(numbers, np.ones(len(numbers), dtype=bool))
  path = tmp_path / "identified.json"
  path.write_text(json.dumps({"format": "mjlab overlay 1", "timestep": 0.002, **content}))
  overlay = read_overlay(path)
  assert overlay.model
  overlay.edit_model(spec)
  model, plain = spec.compile(), mujoco.MjModel.from_xml_string(EVERYTHING)
  has_changed = False
  for field in overlay.model:
    owner, attribute = (model.opt, field[4:]) if field.startswith("opt.") else (model, field)
    before = np.asarray(getattr(plain.opt if owner is model.opt else plain, attribute))
    wanted = getattr(worlds.sim.model, field, worlds.sim.default_field(field))[0].numpy()
    np.testing.assert_allclose(getattr(owner, attribute), wanted, rtol=1e-6, atol=1e-9, err_msg=field)
    has_changed |= not np.allclose(wanted, before, rtol=1e-6, atol=1e-9)
  assert has_changed


def test_a_value_that_cannot_act_is_refused(tmp_path: Path) -> None:
  body = '<body name="a"><geom name="g" size=".1"/></body>'
  framed = f'<mujoco><worldbody><frame pos="1 0 0">{body}</frame></worldbody></mujoco>'
  path = tmp_path / "a.json"
  path.write_text(json.dumps({"format": "mjlab overlay 1", "model": {"body_pos": {"a": [0.5, 0.0, 0.0]}}}))
  with pytest.raises(MjlabError, match=r"body_pos of 'a' cannot be \[0\.5, 0\.0, 0\.0\]: a frame"):
    read_overlay(path).edit_model(mujoco.MjSpec.from_string(framed))


def test_a_capsule_between_two_points_and_angles_in_degrees_are_held(tmp_path: Path) -> None:
  spec = mujoco.MjSpec.from_string("""
    <mujoco><worldbody><body name="a"><joint name="j" axis="0 1 0" range="-90 90" springref="10"/>
    <geom name="g" type="capsule" size=".02" fromto="0 0 0 0 .1 .3"/></body></worldbody></mujoco>""")
  plain = spec.compile()
  values = {"jnt_range": {"j": [-1.0, 1.2]}, "qpos_spring": {"j": 0.3}, "qpos0": {"j": 0.1}}
  size = [0.03, *plain.geom("g").size[1:]]
  path = tmp_path / "a.json"
  path.write_text(json.dumps({"format": "mjlab overlay 1", "model": values | {"geom_size": {"g": size}}}))
  read_overlay(path).edit_model(spec)
  model = spec.compile()
  np.testing.assert_allclose(model.joint("j").range, [-1.0, 1.2])
  np.testing.assert_allclose([model.qpos_spring[0], model.qpos0[0]], [0.3, 0.1])
  np.testing.assert_allclose(model.geom("g").size, size)
  np.testing.assert_allclose(model.geom("g").pos, plain.geom("g").pos)
