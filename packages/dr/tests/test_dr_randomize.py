"""Randomised models: distribution, independence, no drift, and derived fields against a recompiled model."""

import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from mjlab_dr import (
  Categorical,
  FieldRandomizer,
  Gaussian,
  LogUniform,
  Uniform,
  body_com_offset,
  encoder_bias,
  geom_friction,
  needs_constants,
  randomize,
  randomize_field,
)
from scipy import stats

XML = """
<mujoco model="mine">
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" condim="6"/>
    <body name="trunk" pos="0 0 1">
      <freejoint name="root"/>
      <geom name="trunk" type="box" size=".1 .2 .3" mass="2"/>
      <camera name="eye" mode="trackcom" pos="1 0 0"/>
      <body name="left" pos="0 0 -.3">
        <joint name="left_knee" axis="0 1 0" armature=".01"/>
        <geom name="left_foot" type="capsule" size=".05" fromto="0 0 0 0 0 -.4" mass="1" friction=".5 .01 .002"/>
        <site name="tip" pos="0 0 -.4"/>
      </body>
      <body name="right" pos="0 .2 -.3">
        <joint name="right_knee" axis="0 1 0"/>
        <geom name="right_foot" type="capsule" size=".05" fromto="0 0 0 0 0 -.4" mass="1"/>
        <geom type="sphere" size=".01" mass=".01"/>
      </body>
    </body>
    <body name="cube" pos="3 0 1"><freejoint/><geom size=".1" mass="1"/></body>
    <site name="anchor"/>
  </worldbody>
  <tendon>
    <spatial name="rope"><site site="anchor"/><site site="tip"/></spatial>
    <fixed name="couple"><joint joint="left_knee" coef="2"/><joint joint="right_knee" coef="1"/></fixed>
  </tendon>
  <actuator><motor joint="left_knee" gear="3"/></actuator>
</mujoco>"""
ROWS = 2000
WRONG_DISTRIBUTION: dict[str, Any] = {"distribution": "normal"}
WRONG_OPERATION: dict[str, Any] = {"operation": "absolut"}
NO_VALUES: list[Any] = [0.5, None, (0.3,), (0.3, 1.2, 2.0), ("0.3", "1.2"), Uniform, {"sliding": 1.0}]
HALF: Any = 2.5
COM = {"x": (-0.02, 0.03), "y": (0.0, 0.01), "z": (-0.05, -0.01)}


@pytest.fixture
def model() -> mujoco.MjModel:
  return mujoco.MjModel.from_xml_string(XML)


def arrays(model: mujoco.MjModel) -> dict[str, np.ndarray]:
  names = [n for n in dir(model) if not n.startswith("_")]
  return {n: a.copy() for n in names if isinstance(a := getattr(model, n, None), np.ndarray)}


def recompiled(model: mujoco.MjModel) -> mujoco.MjModel:
  """The same model compiled from a spec with the inertial properties of `model` written out."""
  spec = mujoco.MjSpec.from_string(XML)
  for i in range(1, model.nbody):
    body = spec.bodies[i]
    body.explicitinertial = True
    body.ipos, body.iquat = model.body_ipos[i], model.body_iquat[i]
    body.mass, body.inertia = model.body_mass[i], model.body_inertia[i]
  return spec.compile()


def test_derived_fields_of_a_plain_model_equal_a_recompiled_one(model: mujoco.MjModel) -> None:
  untouched = arrays(model)
  randomize(model, [body_com_offset("trunk|left", COM)], seed=1)
  oracle = recompiled(model)
  for name, expected in arrays(oracle).items():
    actual = getattr(model, name)
    if expected.dtype.kind == "f":
      np.testing.assert_allclose(actual, expected, rtol=1e-9, atol=1e-12, err_msg=name)
    else:
      np.testing.assert_array_equal(actual, expected, err_msg=name)
  assert model.stat.meaninertia == pytest.approx(oracle.stat.meaninertia, rel=1e-12)
  assert not np.array_equal(model.dof_invweight0, untouched["dof_invweight0"])


def test_tensors_are_drawn_again_in_masked_worlds_in_place(model: mujoco.MjModel) -> None:
  cfgs = [body_com_offset("trunk", COM), geom_friction("left_foot", (0.3, 1.2)), encoder_bias("left_knee", (0.0, 0.1))]
  compiled = arrays(model)
  fields = randomize(model, cfgs, num_worlds=4, seed=1)
  assert all(np.array_equal(value, compiled[name]) for name, value in arrays(model).items())
  kept, before = dict(fields), {name: value.clone() for name, value in fields.items()}
  mask = torch.tensor([True, False, True, False])
  for _ in range(3):
    fields.resample(mask)
  for name, value in before.items():
    assert fields[name] is kept[name]
    assert torch.equal(fields[name][~mask], value[~mask]), name
    assert not torch.equal(fields[name][mask], value[mask]), name
  model.body_ipos[:] = fields["body_ipos"][2].numpy()
  oracle = recompiled(model)
  np.testing.assert_allclose(fields["dof_invweight0"][2], oracle.dof_invweight0, rtol=1e-5)
  again = randomize(model, cfgs, num_worlds=4, seed=7)
  fields.resample(seed=7)
  assert torch.equal(fields["geom_friction"], again["geom_friction"])


def test_given_tensors_are_written_where_numbers_are_drawn_alone(model: mujoco.MjModel) -> None:
  mine = {"geom_friction": torch.full((5, model.ngeom, 3), 7.0, dtype=torch.float64)}
  fields = randomize(model, [geom_friction("left_foot", (0.3, 1.2)), body_com_offset("trunk", COM)], tensors=mine)
  assert fields["geom_friction"] is mine["geom_friction"]
  foot = model.geom("left_foot").id
  assert ((mine["geom_friction"][:, foot, 0] >= 0.3) & (mine["geom_friction"][:, foot, 0] <= 1.2)).all()
  assert int((mine["geom_friction"] != 7.0).sum()) == 5
  assert fields["body_ipos"].shape == (5, model.nbody, 3)
  assert fields["body_ipos"].dtype == torch.float64
  wrong = {"geom_friction": torch.zeros(5, 3)}
  with pytest.raises(ValueError, match=r"tensor 'geom_friction' is \(5, 3\), .* \(5, 6, 3\)"):
    randomize(model, [geom_friction("left_foot", (0.3, 1.2))], tensors=wrong)
  misspelt = {"geom_fricton": mine["geom_friction"]}
  with pytest.raises(ValueError, match=r"tensors: field 'geom_fricton' does not exist\. Nearest: geom_friction"):
    randomize(model, [geom_friction("left_foot", (0.3, 1.2))], tensors=misspelt)
  with pytest.raises(ValueError, match=r"num_worlds must be .* got 2\.5"):
    randomize(model, [geom_friction("left_foot", (0.3, 1.2))], num_worlds=HALF)


CASES = [
  (geom_friction(".*_foot", (0.3, 1.2)), stats.uniform(0.3, 0.9), [2, 3], [0]),
  (geom_friction(".*_foot", LogUniform(1e-4, 2e-2), axes=(1,)), stats.loguniform(1e-4, 2e-2), [2, 3], [1]),
  (geom_friction("floor", (0.1, 9.0), distribution="log_uniform"), stats.loguniform(0.1, 9.0), [0], [0]),
  (geom_friction("right_foot", (0.5, 2.0), operation="scale"), stats.uniform(0.5, 1.5), [3], [0]),
  (geom_friction("right_foot", (0.0, 2.0), operation="add"), stats.uniform(1.0, 2.0), [3], [0]),
  (geom_friction("left_foot|floor", Gaussian(0.8, 0.2, lo=0.5)), stats.truncnorm(-1.5, np.inf, 0.8, 0.2), [0, 2], [0]),
  (body_com_offset("trunk", (-0.1, 0.1)), stats.uniform(-0.1, 0.2), [1], [0, 1, 2]),
  (body_com_offset("trunk", (0.0, 0.1), distribution="gaussian"), stats.norm(0.0, 0.1), [1], [0, 1, 2]),
]  # fmt: skip


@pytest.mark.parametrize(("cfg", "distribution", "elements", "axes"), CASES, ids=[c[0].label for c in CASES])
def test_draws_are_independent_between_elements_axes_and_worlds(
  model: mujoco.MjModel, cfg: FieldRandomizer, distribution: stats.rv_continuous, elements: list[int], axes: list[int]
) -> None:  # fmt: skip
  rows = 300 if needs_constants(cfg.field) else ROWS
  field = randomize(model, [cfg], num_worlds=rows, seed=4, dtype=torch.float64)[cfg.field].numpy()
  touched = np.zeros(field.shape[1:], dtype=bool)
  touched[np.ix_(elements, axes)] = True
  columns = field[:, touched]
  for column in columns.T:
    assert stats.kstest(column, distribution.cdf).pvalue > 1e-3
  if columns.shape[1] > 1:
    correlation = np.corrcoef(columns.T) - np.eye(columns.shape[1])
    assert np.abs(correlation).max() < 4.5 / np.sqrt(rows)
  default = getattr(model, cfg.field)
  np.testing.assert_array_equal(field[:, ~touched], np.broadcast_to(default[~touched], field[:, ~touched].shape))


def test_a_shared_draw_is_one_for_all_elements_of_a_world(model: mujoco.MjModel) -> None:
  friction = randomize(model, [geom_friction(".*foot", (0.3, 1.2), shared=True)], num_worlds=50, seed=0)[
    "geom_friction"
  ]
  assert torch.equal(friction[:, 2, 0], friction[:, 3, 0])
  assert len(friction[:, 2, 0].unique()) == 50


def test_a_seed_repeats_and_a_drawn_seed_is_an_attribute(model: mujoco.MjModel) -> None:
  cfgs = [geom_friction(".*foot", (0.3, 1.2)), encoder_bias(".*knee", (-0.01, 0.01))]
  first = randomize(model, cfgs)
  again = randomize(mujoco.MjModel.from_xml_string(XML), cfgs, seed=first.seed)
  assert first.changes() == again.changes()
  assert randomize(mujoco.MjModel.from_xml_string(XML), cfgs).changes() != again.changes()


def test_several_randomizers_compose_on_axes_and_the_report_has_values_before_and_after(model: mujoco.MjModel) -> None:
  cfgs = [
    geom_friction("left_foot", {"sliding": (0.7, 0.7), "rolling": (0.001, 0.001)}),
    geom_friction("left_foot", (0.02, 0.02), axes=("torsional",)),
    body_com_offset("trunk", {"z": (0.05, 0.05)}),
    encoder_bias("left_knee", (0.01, 0.01)),
  ]
  once = randomize(model, cfgs, seed=0)
  np.testing.assert_allclose(model.geom("left_foot").friction, (0.7, 0.02, 0.001))
  biases = {change.element: change.after for change in once.changes() if change.field == "encoder_bias"}
  assert biases == pytest.approx({"left_knee": 0.01})
  lines = [line.split() for line in once.report().splitlines()]
  assert lines[0] == ["field", "element", "axis", "before", "after"]
  assert lines[1] == ["geom_friction", "left_foot", "sliding", "0.5", "0.7"]
  assert ["body_ipos", "trunk", "z", "0", "0.05"] in lines
  assert lines[-1] == ["encoder_bias", "left_knee", "0", "0.01"]


def test_the_spring_of_a_joint_composes_with_its_zero_in_either_order() -> None:
  xml = '<mujoco><worldbody><body><joint name="hip" stiffness="1"/><geom size=".1"/></body></worldbody></mujoco>'
  zero = randomize_field("qpos0", "hip", (0.1, 0.1))
  spring = randomize_field("qpos_spring", "hip", (0.02, 0.02))
  for cfgs in ([zero, spring], [spring, zero], [zero, zero, spring], [spring, zero, zero]):
    once = randomize(mujoco.MjModel.from_xml_string(xml), cfgs, seed=0)
    for _ in range(2):
      once.resample()
      shift = 0.1 * cfgs.count(zero)
      np.testing.assert_allclose(once.model.qpos0, [shift])
      np.testing.assert_allclose(once.model.qpos_spring, [shift + 0.02])


SERVOS = """<mujoco>
  <worldbody>
    <body><joint name="hip" axis="0 1 0"/><geom size=".1" pos=".2 0 0"/></body>
    <body><joint name="knee" axis="0 1 0"/><geom size=".1" pos=".2 0 0"/></body>
  </worldbody>
  <actuator><position name="hip" joint="hip" kp="20" kv="3"/><motor name="knee" joint="knee"/></actuator>
</mujoco>"""


@pytest.mark.parametrize(("operation", "lo", "hi"), [("scale", 0.5, 1.5), ("add", -5.0, 5.0), ("absolute", 10.0, 30.0)])
def test_kp_of_a_position_actuator_is_one_number_in_its_gain_and_its_feedback(
  operation: Any, lo: float, hi: float
) -> None:
  model = mujoco.MjModel.from_xml_string(SERVOS)
  kp = randomize_field("actuator_kp", ".*", (lo, hi), operation=operation)
  fields = randomize(model, [kp], num_worlds=400, seed=0)
  gain, feedback = fields["actuator_gainprm"], fields["actuator_biasprm"]
  assert torch.equal(gain[:, 0, 0], -feedback[:, 0, 1])
  spread = {"scale": 20.0, "add": 1.0, "absolute": 1.0}[operation]
  start = 20.0 if operation == "add" else 0.0
  assert stats.kstest(gain[:, 0, 0].numpy(), stats.uniform(start + spread * lo, spread * (hi - lo)).cdf).pvalue > 1e-3
  untouched = [torch.tensor(x, dtype=torch.float32) for x in (model.actuator_gainprm, model.actuator_biasprm)]
  for tensor, compiled, column in ((gain, untouched[0], 0), (feedback, untouched[1], 1)):
    rest = torch.ones(2, 10, dtype=torch.bool)
    rest[0, column] = False
    assert (tensor[:, rest] == compiled[rest]).all()


def test_kp_of_other_actuators_and_impossible_kp_are_refused() -> None:
  def refused(message: str, *cfgs: FieldRandomizer) -> None:
    with pytest.raises(ValueError, match=message):
      randomize(mujoco.MjModel.from_xml_string(SERVOS), cfgs, seed=0)

  refused("'knee' would do nothing, for it is no position actuator", randomize_field("actuator_kp", "knee", (1.0, 2.0)))
  less = randomize_field("actuator_kp", "hip", (-21.0, 0.0), operation="add")
  refused("actuator 'hip' may get kp -1, below the physical minimum 0", less)
  twice = (
    randomize_field("actuator_kp", "hip", (0.5, 2.0)),
    randomize_field("actuator_gainprm", "hip", {"0": (1.0, 2.0)}),
  )
  refused("actuator 'hip' is written by two randomizers", *twice)


def test_a_custom_distribution_works(model: mujoco.MjModel) -> None:
  class Coin:
    def check(self, name: str) -> None: ...

    def support(self) -> tuple[float, float]:
      return 0.5, 1.0

    def sample(self, shape, *, generator, device, dtype) -> torch.Tensor:
      return 0.5 + 0.5 * torch.randint(2, tuple(shape), generator=generator, device=device).to(dtype)

  values = {"sliding": Coin(), "torsional": Uniform(0.0, 0.1)}
  friction = randomize(model, [geom_friction("left_foot", values)], num_worlds=100, seed=0)["geom_friction"][:, 2]
  assert set(friction[:, 0].tolist()) == {0.5, 1.0}
  assert 0.0 <= friction[:, 1].min() < friction[:, 1].max() <= 0.1


@pytest.mark.parametrize(
  ("make", "message"),
  [
    (lambda: randomize_field("geom_fricton", "foot", (0.0, 1.0)), r"not exist\. Nearest: geom_friction"),
    (lambda: geom_friction("foot", (1.2, 0.3)), r"sliding: \(lo, hi\) must not fall, got \(1\.2, 0\.3\)"),
    (lambda: geom_friction("foot", Gaussian(0.5, -0.1, lo=0.0)), "std must not be negative, got -0.1"),
    (lambda: geom_friction("foot", Gaussian(0.5, 0.1, lo=2.0)), "more than 5 std"),
    (lambda: body_com_offset("trunk", (-0.1, 0.1), distribution="log_uniform"), "lo must be positive"),
    (lambda: geom_friction("foot", LogUniform(0.0, 1.0)), "must be positive"),
    (lambda: geom_friction("foot", (0.0, float("inf"))), "hi must be finite, got inf"),
    (lambda: geom_friction("foot", (0.0, 1.0), **WRONG_DISTRIBUTION), "distribution 'normal' does not exist"),
    (lambda: geom_friction("foot", (0.0, 1.0), **WRONG_OPERATION), r"'absolut' does not exist\. Nearest: absolute"),
    (lambda: body_com_offset("trunk", {"w": (0.0, 1.0)}), "axis 'w' does not exist"),
    (lambda: geom_friction("foot", (0.0, 1.0), axes=(3,)), "axis 3 does not exist; there are 3"),
    (lambda: geom_friction("foot", {0: (0.0, 1.0)}, axes=(0,)), "either axes or values by axis"),
    (lambda: geom_friction("foot", {}), "no axis is given values"),
    (lambda: geom_friction((), (0.0, 1.0)), "no pattern is given"),
    (lambda: geom_friction("foot", Categorical(("low", "high"))), "names are for what is chosen among named things"),
    *[
      (lambda values=values: geom_friction("foot", values), r"sliding: .* neither two numbers, \(lo, hi\), nor a dist")
      for values in NO_VALUES
    ],
  ],
)  # fmt: skip
def test_a_randomizer_that_cannot_be_is_refused_when_it_is_made(make, message: str) -> None:
  with pytest.raises(ValueError, match=message):
    make()


def test_a_list_of_two_numbers_and_a_single_axis_are_read_as_they_are_meant() -> None:
  values: Any = [0.3, 1.2]
  assert geom_friction("foot", values) == geom_friction("foot", (0.3, 1.2))
  for axis in (1, "torsional"):
    assert geom_friction("foot", values, axes=axis) == geom_friction("foot", (0.3, 1.2), axes=(1,))


@pytest.mark.parametrize(
  ("cfg", "message"),
  [
    (geom_friction("hand_.*", (0.3, 1.2)), r"geom_friction: pattern 'hand_\.\*' matches no geom\."),
    (geom_friction("left_foot", (-0.6, 0.0), operation="add"), r"geom 'left_foot' may get sliding -0\.1, below"),
    (geom_friction("left_foot", (0.5, 0.1), distribution="gaussian"), "sliding -inf, .* Truncate the Gaussian"),
    (body_com_offset("world", (0.0, 0.1)), "pattern 'world' matches no body"),
    (body_com_offset("cube", (0.0, 0.1)), r"body 'cube' would do nothing, for it was compiled as simple"),
    (encoder_bias("root", (0.0, 0.1)), r"joint 'root' would do nothing, for it has more than one coordinate"),
  ],
)  # fmt: skip
def test_a_randomizer_that_does_not_fit_the_model_is_refused_before_it_writes(
  model: mujoco.MjModel, cfg: FieldRandomizer, message: str
) -> None:
  before = arrays(model)
  with pytest.raises(ValueError, match=message):
    randomize(model, [geom_friction("right_foot", (0.3, 1.2)), cfg], seed=0)
  for name, value in arrays(model).items():
    np.testing.assert_array_equal(value, before[name], err_msg=name)


def test_elements_without_a_name_can_still_be_selected(model: mujoco.MjModel) -> None:
  friction = randomize(model, [geom_friction(".*", (0.3, 0.4))], num_worlds=2, seed=0)["geom_friction"]
  assert (friction[..., 0] <= 0.4).all()
  assert "(geom 4)" in randomize(model, [geom_friction(".*", (0.3, 0.4))], seed=0).report()


def test_the_example_of_the_readme_runs() -> None:
  readme = Path(__file__).parents[1] / "README.md"
  for block in re.findall(r"```python\n(.*?)```", readme.read_text(), re.DOTALL):
    exec(compile(block, str(readme), "exec"), {})


def test_the_example_script_randomises_a_robot_and_prints_the_changes(capsys) -> None:
  script = runpy.run_path(str(Path(__file__).parents[1] / "examples" / "randomize_my_robot.py"))
  script["main"]()
  printed = capsys.readouterr().out
  assert re.search(r"^body_mass +base +5 +\d", printed, re.MULTILINE)
  distances = re.findall(r"pushed (\d\.\d+) m", printed)
  assert len(set(distances)) == 5
  model = mujoco.MjModel.from_xml_string(script["ROBOT"])
  # What was restored moves as the model that was never touched.
  assert f"as compiled: pushed {script['pushed'](model):.3f} m" in printed


def test_it_needs_no_warp() -> None:
  code = """
import sys, torch
sys.modules["warp"] = None  # as if it were not installed
import mjlab_dr
body = torch.ones(1), torch.zeros(1, 3), torch.ones(1, 3), torch.tensor([[1.0, 0.0, 0.0, 0.0]])
mjlab_dr.perturb_inertia(*body, torch.full((1, 10), 0.1))
assert "mujoco_warp" not in sys.modules
"""
  subprocess.run([sys.executable, "-c", code], check=True)
