"""Bodies that MuJoCo compiles as simple: a draw acts as in a recompiled model, or the body is refused by name.

The compiler marks a body as simple where its inertia matrix is diagonal and constant, and lays out the engine's memory
for that. A field that would make the matrix anything else then acts wrongly without a word, on every engine.
"""

import mujoco
import numpy as np
import pytest
from mjlab_dr import FIELDS, FieldRandomizer, pseudo_inertia, randomize, randomize_field

SLIDES = '<joint name="a" type="slide" axis="1 0 0" {more}/><joint name="b" type="slide" axis="0 1 0" {more}/>'
BALL = '<joint name="b" type="ball" range="0 1" stiffness="1" frictionloss=".1" damping=".2" armature=".1"/>'
JOINTS = {
  "free": '<freejoint name="a"/>',
  "puck": SLIDES + '<joint name="c" {more}/>',
  "slides": SLIDES,
  "ball": BALL,
  "slide and ball": '<joint name="a" type="slide" {more}/>' + BALL,
  "hinge": '<joint name="a" {more}/>',
  "slide": '<joint name="a" type="slide" {more}/>',
}
ROWS = [name for name, field in FIELDS.items() if field.kind in ("body", "joint") and field.in_model]
MORE = 'stiffness="1" springref=".1" range="-1 1" frictionloss=".1" damping=".2" armature=".1" actuatorfrcrange="-9 9"'


def spec_of(kind: str, *, simple: bool = True) -> mujoco.MjSpec:
  joints = JOINTS[kind].format(more=MORE)
  spec = mujoco.MjSpec.from_string(f"""<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="thing" gravcomp=".1">{joints}<inertial pos="0 0 0" mass="2" diaginertia=".1 .15 .12"/></body>
    <body name="link"><joint name="link" axis="0 1 0"/><inertial pos=".1 0 0" mass="1" diaginertia=".1 .1 .1"/></body>
  </worldbody>
</mujoco>""")
  spec.body("thing").simple = simple
  return spec


def cfg_of(name: str, pattern: str) -> FieldRandomizer:
  field = FIELDS[name]
  if name == "pseudo_inertia":
    return pseudo_inertia(pattern, scale=0.2, t=(0.05, 0.1))
  if field.ordered:
    return randomize_field(name, pattern, {"upper": (0.1, 0.2)}, operation="add")
  if field.form in ("rotation", "direction") or field.operation == "add":
    return randomize_field(name, pattern, (0.1, 0.3), operation="add")
  return randomize_field(name, pattern, (0.8, 0.9), operation="scale")


def accelerations(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
  """Of a body that spins, slides, turns and is pushed, in three states."""
  out = []
  for seed in range(3):
    rng, data = np.random.default_rng(seed), mujoco.MjData(model)
    data.qpos[:] = qpos + 0.3 * rng.normal(size=model.nq)
    mujoco.mj_normalizeQuat(model, data.qpos)
    data.qvel[:], data.qfrc_applied[:] = rng.normal(size=(2, model.nv))
    data.xfrc_applied[1:] = rng.normal(size=(model.nbody - 1, 6))
    mujoco.mj_forward(model, data)
    out.append(data.qacc.copy())
  return np.array(out)


# A model that was written may be compiled again, with its mean inertia, which MuJoCo gives up.
@pytest.mark.filterwarnings("ignore:statistic attribute 'meaninertia'")
@pytest.mark.parametrize("simple", [True, False], ids=["compiled as simple", "not simple"])
@pytest.mark.parametrize("name", ROWS)
def test_a_draw_acts_as_in_a_recompiled_model_or_is_refused(name: str, simple: bool) -> None:
  for kind in JOINTS:
    spec = spec_of(kind, simple=simple)
    model = spec.compile()
    assert bool(model.body("thing").simple[0]) is simple
    qpos = model.qpos0.copy()
    cfg, why = cfg_of(name, "thing" if FIELDS[name].kind == "body" else "[abc]"), ""
    try:
      randomize(model, [cfg], seed=0)
    except ValueError as error:
      why = str(error)
    if why:
      assert "would do nothing" in why or (simple and "compiled as simple" in why)
      continue
    spec.copy_back(model)
    # What it leaves as it was.
    spec.body("thing").gravcomp = float(model.body_gravcomp[1])
    for joint in spec.joints:
      joint.actfrcrange = model.jnt_actfrcrange[joint.id]
    found, expected = accelerations(model, qpos), accelerations(spec.compile(), qpos)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9, err_msg=kind)


FIXED = {
  "body_ipos": ("free", "puck", "slides", "ball", "hinge"),
  "body_iquat": ("free", "puck", "slides", "ball", "hinge"),
  "pseudo_inertia": ("free", "puck", "slides", "ball", "hinge"),
  "jnt_pos": ("puck", "ball", "slide and ball"),
  "jnt_axis": ("puck", "slides"),
}


@pytest.mark.parametrize(("name", "kind"), [(name, kind) for name, kinds in FIXED.items() for kind in kinds])
def test_a_simple_body_is_left_out_of_a_pattern_with_a_warning_and_refused_alone(name: str, kind: str) -> None:
  model = spec_of(kind).compile()
  only = "thing" if FIELDS[name].kind == "body" else "[abc]"
  with pytest.raises(ValueError, match=r"body 'thing'.* was compiled as simple.*simple=\"false\".*MjSpec"):
    randomize(model, [cfg_of(name, only)], seed=0)
  with pytest.raises(ValueError, match=r"body 'thing'.* was compiled as simple"):
    randomize(model, [cfg_of(name, only)], num_worlds=2, seed=0)
  with pytest.warns(UserWarning, match=rf"{name}.*'(thing|a|b|c)'.*compiled as simple"):
    once = randomize(model, [cfg_of(name, ".*")], seed=0)
  assert {change.element for change in once.changes()} == {"link"}


def test_draws_that_leave_a_simple_body_simple_are_allowed() -> None:
  model = spec_of("free").compile()
  once = randomize(model, [pseudo_inertia("thing", alpha=(0.1, 0.2), d=(0.1, 0.2))], seed=0)
  assert once.changes()
