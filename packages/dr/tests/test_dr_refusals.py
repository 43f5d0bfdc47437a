"""What is refused by name before anything is trained on it: no effect, nothing physical, or nothing there."""

import copy
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from mjlab_dr import (
  FIELDS,
  Categorical,
  Custom,
  FieldRandomizer,
  Gaussian,
  body_mass,
  pseudo_inertia,
  randomize,
  randomize_field,
)
from mjlab_dr.effect import idle
from mjlab_dr.fields import element_names, rows

# The tests share a module.
sys.path.insert(0, str(Path(__file__).parent))

from dr_everything import EVERYTHING


@pytest.fixture
def model() -> mujoco.MjModel:
  return mujoco.MjModel.from_xml_string(EVERYTHING)


def refused(model: mujoco.MjModel, cfg: FieldRandomizer, message: str) -> None:
  before = {name: getattr(model, name).copy() for name in ("geom_size", "body_mass", "jnt_range")}
  with pytest.raises(ValueError, match=message):
    randomize(model, [cfg], seed=0)
  for name, value in before.items():
    np.testing.assert_array_equal(getattr(model, name), value)


FIELD = randomize_field
IDLE = [
  (FIELD("jnt_range", "crank", (-1.0, 1.0)), "joint 'crank' would do nothing, for it has no limits"),
  (FIELD("jnt_actfrcrange", "slide", (-1.0, 1.0)), "joint 'slide' would do nothing, for it has no limit of actuator"),
  (FIELD("jnt_axis", "shoulder", (0.0, 0.1)), "turns about any axis"),
  (FIELD("jnt_pos", "root", (0.0, 0.1)), "has no anchor"),
  (FIELD("qpos0", "shoulder", (0.0, 0.1)), "has more than one coordinate"),
  (FIELD("qpos_spring", "crank", (0.0, 0.1)), "has no spring"),
  (FIELD("dof_solref", "crank", (0.01, 0.02)), "has no dry friction"),
  (FIELD("actuator_forcerange", "rope", (-1.0, 1.0)), "actuator 'rope' would do nothing, for it has no limit of force"),
  (FIELD("actuator_ctrlrange", "pull", (-1.0, 1.0)), "has no limit of control"),
  (FIELD("actuator_actrange", "hip", (-1.0, 1.0)), "has no limit of activation"),
  (FIELD("actuator_dynprm", "hip", (0.1, 0.2), axes=(0,)), "has no dynamics"),
  (FIELD("actuator_gainprm", "hip", (0.1, 0.2), axes="3"), "3 of actuator 'hip'"),
  (FIELD("actuator_biasprm", "rope", (0.1, 0.2), axes="7"), "7 of actuator 'rope'"),
  (FIELD("actuator_biasprm", "pull", (0.1, 0.2), axes="1"), "of actuator 'pull'"),
  (FIELD("actuator_dynprm", "belt", (0.1, 0.2), axes="4"), "4 of actuator 'belt' would do nothing"),
  (FIELD("actuator_delay", "rope", (0.0, 0.01)), "was compiled without a delay"),
  (FIELD("actuator_lengthrange", "hip", (0.1, 0.2)), "is no muscle"),
  (FIELD("actuator_cranklength", "hip", (0.1, 0.2)), "is no slider-crank"),
  (FIELD("actuator_gear", "hip", (1.0, 2.0), axes=(1,)), "of actuator 'hip' would do nothing, for it has one gear"),
  (FIELD("geom_friction", "roller", (0.3, 1.2), axes=(0,)), "collides with nothing"),
  (FIELD("geom_size", "floor", (0.9, 1.1)), "geom 'floor' would do nothing, for it is no primitive"),
  (FIELD("geom_size", "shin", (0.9, 1.1), axes=("size2",)), "size2 of geom 'shin' would do nothing"),
  (FIELD("mat_rgba", "painted", (0.0, 1.0)), "belongs to geoms that have a colour of their own, geom_rgba, instead"),
  (FIELD("geom_adhesion", "shin", (0.0, 1.0)), "was compiled as zero"),
  (FIELD("body_gravcomp", "shin", (0.0, 1.0)), "was compiled as zero"),
  (FIELD("body_pos", "trunk", (0.0, 0.1)), "body 'trunk' would do nothing, for it floats"),
  (FIELD("body_pos", "target", (0.0, 0.1)), "body 'target' would do nothing, for it floats"),
  (FIELD("body_mass", "post", (1.0, 2.0)), "body 'post' would do nothing, for it never moves"),
  (FIELD("body_mass", "target", (1.0, 2.0)), "has no mass"),
  (FIELD("cam_fovy", "lens", (30.0, 60.0)), "has a sensor size"),
  (FIELD("cam_intrinsic", "eye", {"fx": (0.9, 1.1)}), "has no sensor size"),
  (FIELD("light_cutoff", "lamp", (30.0, 60.0)), "is no spot light"),
  (FIELD("mat_texid", "dull", {"normal": Categorical(("wood",))}), "without a texture for it"),
  (FIELD("eq_data", "leash", (0.0, 0.1), axes=("4",)), "4 of equality 'leash' would do nothing, for it follows"),
  (FIELD("eq_data", "glue", (0.0, 0.1), axes=("7",)), "7 of equality 'glue' would do nothing, for it follows"),
  (FIELD("eq_data", "couple", (0.0, 0.1), axes=("6",)), "6 of equality 'couple' would do nothing, for it follows"),
  (FIELD("tendon_range", "belt", (0.0, 1.0)), "tendon 'belt' would do nothing, for it has no limits"),
  (FIELD("tendon_actfrcrange", "belt", (0.0, 1.0)), "has no limit of actuator force"),
  (FIELD("tendon_solref_fri", "belt", (0.01, 0.02)), "has no dry friction"),
]  # fmt: skip


@pytest.mark.parametrize(("cfg", "message"), IDLE, ids=[c[0].label for c in IDLE])
def test_changes_without_effect_are_refused(model: mujoco.MjModel, cfg: FieldRandomizer, message: str) -> None:
  refused(model, cfg, re.escape(message))


PROBED = [
  name
  for name, field in FIELDS.items()
  if field.kind in ("body", "joint", "tendon", "actuator", "equality") and field.in_model and field.form == "plain"
]


@pytest.mark.parametrize("name", PROBED)
def test_numbers_without_effect_change_no_step(model: mujoco.MjModel, name: str) -> None:
  kind = FIELDS[name].kind
  ids = range(1 if kind == "body" else 0, len(element_names(model, kind)))
  found = idle(model, name, ids, range(FIELDS[name].width))
  for i in ids:
    reasons = {found.get((i, axis), "") for axis in range(FIELDS[name].width)}
    if "" in reasons or reasons & HAS_EFFECT:
      continue
    changed = copy.copy(model)
    for row in rows(model, FIELDS[name], i):
      getattr(changed, name)[row] = 2.0 * getattr(changed, name)[row] + 1.0
    before, after = (moved(each) for each in (model, changed))
    np.testing.assert_array_equal(after, before, err_msg=f"{name} {i}")


# Refused although MuJoCo's own engine would act on it.
HAS_EFFECT = {"was compiled as zero, and engines leave out what is off", "has more than one coordinate"}


def moved(model: mujoco.MjModel) -> np.ndarray:
  """Positions and velocities of a driven run with active equalities."""
  data, rng, rows = mujoco.MjData(model), np.random.default_rng(1), []
  data.eq_active[:], data.mocap_pos[:], data.qvel[:] = 1, 0.0, rng.uniform(-1.0, 1.0, model.nv)
  for _ in range(60):
    data.ctrl[:] = rng.uniform(-3.0, 3.0, model.nu)
    mujoco.mj_step(model, data)
    rows.append(np.concatenate((data.qpos, data.qvel, data.act)))
  return np.array(rows)


def test_a_pattern_leaves_out_elements_without_effect_and_is_refused_if_none_is_left(model: mujoco.MjModel) -> None:
  once = randomize(model, [randomize_field("jnt_range", ".*", (0.9, 1.0), operation="scale")], seed=0)
  assert {change.element for change in once.changes()} == {"hip", "slide", "shoulder"}
  several = r"joint 'root' would do nothing, for it has no limits\. Nor would one of the 1 others"
  refused(model, randomize_field("jnt_range", "root|crank", (0.9, 1.0)), several)
  # One word of several that does nothing is as much a mistake as one alone.
  refused(model, randomize_field("jnt_range", ("hip", "crank"), (0.9, 1.0)), "joint 'crank' would do nothing")


def scaled(field: str, pattern: str | tuple[str, ...], axes: Any = None) -> FieldRandomizer:
  return FIELD(field, pattern, (0.5, 2.0), axes=axes, operation="scale")


@pytest.mark.parametrize(
  ("cfg", "message"),
  [
    (scaled("dof_frictionloss", "crank"), "joint 'crank' would do nothing, for it is zero, as is every multiple"),
    (scaled("jnt_stiffness", "root|crank"), r"as is every multiple\. Nor would one of the 1 others that match"),
    (scaled("jnt_stiffness", ("hip", "crank")), "joint 'crank' would do nothing"),
    (scaled("opt.gravity", ".*", "x"), "x of option 'option' would do nothing"),
    (scaled("body_ipos", "arm|shin", "y"), "y of body 'shin' would do nothing"),
    (scaled("jnt_axis", "hip", ("x", "z")), "x of joint 'hip' would do nothing"),
  ],
)  # fmt: skip
def test_multiples_of_zero_are_refused(model: mujoco.MjModel, cfg: FieldRandomizer, message: str) -> None:
  refused(model, cfg, message)


def test_a_pattern_leaves_out_multiples_of_zero(model: mujoco.MjModel) -> None:
  once = randomize(model, [scaled("jnt_stiffness", ".*"), scaled("opt.gravity", ".*")], seed=0)
  changed = {change.element for change in once.changes() if change.field == "jnt_stiffness" and change.before}
  assert changed == {"hip", "slide", "shoulder"}
  assert [change.axis for change in once.changes() if change.after != change.before][-1] == "z"


CONTACTS = """<mujoco><worldbody>
  <geom name="floor" type="plane" size="0 0 1" condim="3"/>
  <geom name="wall" size=".1"/>
  <body name="foot"><freejoint/><geom name="foot" size=".1" priority="1" condim="3"/></body>
  <body name="ball"><freejoint/><geom name="ball" size=".1" condim="6" contype="0" conaffinity="2"/></body>
  <body name="pin"><freejoint/><geom name="pin" size=".1" contype="2" conaffinity="0"/></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize(
  ("geom", "axis", "reason"),
  [
    # Only the foot may touch the floor, and its priority is the higher one.
    ("floor", "sliding", "has a lower priority than all that it can touch"),
    ("foot", "torsional", "needs condim 4, which none of its contacts has: it is 3"),
    ("ball", "rolling", ""),
    ("pin", "torsional", ""),
    ("foot", "sliding", ""),
  ],
)
def test_friction_counts_where_a_contact_that_can_be_would_take_it(geom: str, axis: str, reason: str) -> None:
  cfg = FIELD("geom_friction", geom, (0.2, 0.9), axes=axis)
  if reason:
    refused(mujoco.MjModel.from_xml_string(CONTACTS), cfg, re.escape(reason))
  else:
    assert randomize(mujoco.MjModel.from_xml_string(CONTACTS), [cfg], seed=0).changes()


def test_softness_of_a_geom_of_lower_priority_is_refused() -> None:
  model = mujoco.MjModel.from_xml_string(CONTACTS)
  soft: list[tuple[str, Any]] = [
    ("geom_solref", {"axes": "timeconst"}),
    ("geom_solimp", {"axes": "dmin"}),
    ("geom_solmix", {}),
  ]
  for field, more in soft:
    refused(model, FIELD(field, "floor", (0.5, 0.6), **more), "has a lower priority than all that it can touch")
  assert randomize(model, [FIELD("geom_margin", "floor", (0.0, 0.01))], seed=0).changes()


def test_a_state_that_a_motor_was_compiled_without_cannot_be_given_to_it() -> None:
  """MuJoCo tells from these numbers which states it has, and would read those of its neighbour."""
  motor = mujoco.MjModel.from_xml_string("""
<mujoco><worldbody><body><joint name="j"/><geom size=".1"/></body></worldbody>
<actuator><dcmotor name="m" joint="j" motorconst=".1" resistance="1"/></actuator></mujoco>""")
  states = [("actuator_dynprm", axis) for axis in ("0", "2", "5", "7")] + [("actuator_gainprm", "5")]
  for field, axis in states:
    refused(
      motor, FIELD(field, "m", (0.1, 0.2), axes=axis), f"{axis} of actuator 'm' would .* compiled without the state"
    )
  once = randomize(motor, [FIELD("actuator_gainprm", "m", (0.1, 0.2), operation="add")], seed=0)
  # MuJoCo reads the resistance and the constant of the motor, and numbers of a controller that it does not have.
  assert {"0", "1"} <= {change.axis for change in once.changes()} <= set("012346789")


def test_wind_without_a_medium_is_refused() -> None:
  vacuum = mujoco.MjModel.from_xml_string("<mujoco/>")
  refused(vacuum, randomize_field("opt.wind", ".*", (0.0, 1.0)), "needs a density or a viscosity")
  refused(vacuum, randomize_field("opt.density", ".*", (0.0, 1.0)), "compiled as zero")


UNPHYSICAL = [
  (lambda: FIELD("cam_quat", ".*", (0.9, 1.1), operation="scale"), "'scale' is not possible; use 'add'"),
  (lambda: FIELD("geom_matid", ".*", (0.0, 1.0)), "is a choice: give a Categorical"),
  (lambda: FIELD("cam_intrinsic", ".*", (0.0, 1.0), operation="add"), "can make a focal length negative"),
  (lambda: FIELD("geom_size", ".*", {0: (0.9, 1.0), 1: (0.8, 1.0)}, isotropic=True), "isotropic means one draw"),
  (lambda: FIELD("geom_rgba", ".*", Categorical(())), r"needs values, and as many weights, not all zero; got \(\)"),
  (lambda: FIELD("geom_rgba", ".*", Categorical((0.0, 1.0), (1.0,))), r"as many weights, .* and \(1.0,\)"),
  (lambda: FIELD("geom_rgba", ".*", Categorical((0.0, 1.0), (-1.0, 1.0))), "weights must not be negative"),
  (lambda: FIELD("geom_rgba", ".*", Custom(lambda shape, **more: torch.ones(shape), 1.0, 0.0)), "must not fall"),
  (lambda: pseudo_inertia("thigh", scale=-0.1), r"must not fall, got \(0\.1, -0\.1\)"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "message"), UNPHYSICAL)
def test_impossible_randomizers_are_refused_when_they_are_made(make: Callable[[], Any], message: str) -> None:
  with pytest.raises(ValueError, match=message):
    make()


RESULTS = [
  (body_mass("thigh", (0.0, 1.0)), "body 'thigh' may get body_mass 0, at the physical minimum 0"),
  (body_mass("thigh", (-0.1, 1.0), operation="scale"), r"may get body_mass -0\.12, below the physical minimum 0"),
  (FIELD("opt.timestep", ".*", (0.0, 0.01)), "may get opt.timestep 0, at the physical minimum 0"),
  (FIELD("geom_solimp", ".*", (0.5, 1.5), axes=("dmax",)), "may get dmax 1.5, above the physical maximum 0.9999"),
  (FIELD("geom_rgba", ".*", Gaussian(0.5, 0.2, lo=0.0)), r"above the physical maximum 1\. Truncate the Gaussian"),
  (FIELD("cam_fovy", "eye", (10.0, 200.0)), "may get cam_fovy 200, above the physical maximum 180"),
  (FIELD("cam_intrinsic", "lens", {"fx": (-0.1, 1.0)}), "may get fx -0.0003, below the physical minimum 0"),
  (FIELD("light_active", "spot", Categorical((0, 2))), "may get light_active 2, above the physical maximum 1"),
  (FIELD("body_mass", "shin", (-1.0, 0.5), operation="add"), r"body 'shin' may get body_mass -0\.2, below"),
  (FIELD("jnt_range", "hip", {"lower": (0.0, 2.5)}, operation="add"), r"'hip' may get a lower bound of 1\.5 with"),
  (FIELD("actuator_ctrlrange", "hip", (-1.0, 1.0)), "a lower bound of 1 with an upper bound of -1"),
  (FIELD("body_inertia", "trunk", (0.3, 2.0), operation="scale"), "the other two moments sum to 0.039, which no body"),
  (FIELD("geom_solref", "shin", {"timeconst": (-0.1, 0.1)}), "both must be positive, or both negative"),
  (FIELD("geom_solref", "shin", {"timeconst": (-0.2, -0.1)}), "both must be positive, or both negative"),
  (FIELD("light_cutoff", "spot", (0.0, 200.0), operation="add"), r"light 'spot' may get light_cutoff 240, above the"),
  (FIELD("actuator_delay", "hip", (0.0, 0.1)), r"a delay of 0\.1 s, but its buffer was compiled for 0\.016 s"),
  (FIELD("geom_matid", "post", Categorical(("steal", "dull"))), "material 'steal' does not exist"),
  (FIELD("geom_matid", "post", Categorical((0, 7))), "\\(0, 7\\) must be whole numbers below 3"),
]  # fmt: skip


@pytest.mark.parametrize(("cfg", "message"), RESULTS, ids=[c[0].label for c in RESULTS])
def test_unphysical_results_are_refused_before_anything_is_written(
  model: mujoco.MjModel, cfg: FieldRandomizer, message: str
) -> None:
  refused(model, cfg, message)


def test_bounds_moved_by_one_draw_keep_their_order(model: mujoco.MjModel) -> None:
  cfg = randomize_field("jnt_range", "hip", (-0.5, 2.5), operation="add", isotropic=True)
  lower, upper = np.array([randomize(model, [cfg], seed=seed).model.joint("hip").range for seed in range(20)]).T
  np.testing.assert_allclose(upper - lower, 2.2)


@pytest.mark.parametrize(
  ("first", "second"),
  [
    (pseudo_inertia("thigh", scale=0.1), body_mass("thigh", (1.0, 2.0))),
    (pseudo_inertia("thigh", scale=0.1), FIELD("body_inertia", "thigh", (0.9, 1.1), operation="scale")),
    (FIELD("geom_friction", "thigh", (0.3, 1.2), axes=0), FIELD("geom_friction", "th.*", (0.3, 1.2), axes=0)),
  ],
)
def test_a_randomizer_that_would_undo_another_is_refused(
  model: mujoco.MjModel, first: FieldRandomizer, second: FieldRandomizer
) -> None:
  message = rf"'thigh' is written by two randomizers, {re.escape(first.label)} and {second.field} '"
  with pytest.raises(ValueError, match=message):
    randomize(model, [first, second], seed=0)


def test_randomizers_of_one_number_compose_and_do_not_drift(model: mujoco.MjModel) -> None:
  default = {name: getattr(model, name).copy() for name in ("body_mass", "body_ipos", "body_inertia")}
  twofold = [
    pseudo_inertia("thigh", alpha=(0.1, 0.1)),
    body_mass(".*", (2.0, 2.0), operation="scale"),
    FIELD("body_ipos", "thigh|shin", {"x": (0.01, 0.01)}),
  ]
  once = randomize(model, twofold, seed=0)
  thigh, shin = model.body("thigh").id, model.body("shin").id
  for _ in range(3):
    once.resample()
    np.testing.assert_allclose(model.body_mass[thigh], 2.0 * np.exp(0.2) * default["body_mass"][thigh])
    np.testing.assert_allclose(model.body_mass[shin], 2.0 * default["body_mass"][shin])
    np.testing.assert_allclose(model.body_inertia[thigh], np.exp(0.2) * default["body_inertia"][thigh])
    np.testing.assert_allclose(model.body_ipos[[thigh, shin]], default["body_ipos"][[thigh, shin]] + [0.01, 0.0, 0.0])
  rows = [(change.field, change.element, change.axis) for change in once.changes()]
  assert len(rows) == len(set(rows))
  changed = {(change.field, change.element): change for change in once.changes()}
  assert changed["body_mass", "thigh"].before == pytest.approx(default["body_mass"][thigh])
  assert changed["body_mass", "thigh"].after == pytest.approx(model.body_mass[thigh])
