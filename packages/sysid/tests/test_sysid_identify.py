"""Fits of known parameters to simulated records, and names of parameters that cannot be identified."""

import copy
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mjlab_actuators import DcMotorActuatorCfg, IdealPdActuatorCfg
from mjlab_core import MjlabError
from mjlab_dr import randomize, randomize_field
from mjlab_sysid import Identified, IdentifyCfg, Progress, Record, Robot, identify, parse_term
from mjlab_sysid.worlds import Worlds
from sysid_robots import arm, changed, record, sines

FACTORS = {
  "dof_armature:hip": 1.6,
  "dof_armature:knee": 0.6,
  "dof_frictionloss:hip": 3.0,
  "dof_frictionloss:knee": 1.7,
  "dof_damping:hip": 2.0,
  "stiffness:knee": 0.7,
}
TERMS = ("armature:.*", "frictionloss:.*", "viscous_damping:hip", "stiffness:knee")


def fit(robot: Robot, records: list[Record], *terms: str, cfg: IdentifyCfg | None = None, **more: Any) -> Identified:
  """Fit terms, by default in short windows, which take half the time."""
  return identify(robot, records, [parse_term(text) for text in terms], cfg or IdentifyCfg(window=0.12), **more)


def of_joints(made: Record, source: str) -> Record:
  """Return a record without the signals of the IMU and the base."""
  signals = {name: made.signals[name] for name in ("position_target", "position", "velocity") if name in made.signals}
  return Record(source=source, joints=made.joints, time=made.time, signals=signals)


def numbers(found: Identified) -> dict[str, float]:
  return {estimate.parameter.name: estimate.number for estimate in found.estimates}


def agree(found: Identified, wanted: Mapping[str, float], share: float) -> None:
  assert numbers(found).keys() == wanted.keys()
  for name, number in numbers(found).items():
    assert number == pytest.approx(wanted[name], rel=share), name


@pytest.mark.parametrize("timestep", [0.001, 0.002])
def test_known_parameters_are_found_within_five_percent_despite_noise_and_delay(timestep: float) -> None:
  # 7 ms are 3.5 of the longer timestep.
  robot = arm(timestep=timestep)
  true = changed(robot, FACTORS)
  true.opt.timestep = 0.001
  more: dict[str, Any] = {"delay": 7, "noise": 5e-4, "quantum": 4e-4}
  made = [record(robot, true, sines(robot, seed, 2.0), source=str(seed), **more) for seed in (0, 1)]
  found = fit(robot, made[:1], *TERMS, "delay:.*,shared", cfg=IdentifyCfg(), held_out=made[1:])
  agree(found, FACTORS | {"delay:.*": 0.007}, 0.05)
  assert all(estimate.identifiable for estimate in found.estimates)
  held_out = [trace for trace in found.traces if trace.is_held_out]
  assert {trace.record for trace in held_out} == {"1"}
  for trace in held_out:
    before, after = trace.errors
    assert after < 1e-3 < 5e-3 < before
  wanted = np.array([*FACTORS.values(), 0.007])
  # The stated error covers the real one, except that of another timestep.
  if timestep == true.opt.timestep:
    assert np.abs((found.numbers - wanted) / found.information.std).max() < 4.0


def test_a_parameter_that_is_not_identifiable_is_named_and_stays() -> None:
  robot = arm()
  records = [record(robot, changed(robot, FACTORS), sines(robot, 0, 1.5), noise=1e-4)]
  # Both dampers of a servo's joint act as one, and nothing reaches its limit of effort.
  found = fit(robot, records, *TERMS, "damping:hip", "effort_limit:knee=20..60")
  reasons = {estimate.parameter.name: estimate.reason for estimate in found.estimates}
  assert reasons["effort_limit:knee"] == "the records hardly depend on it"
  assert numbers(found)["effort_limit:knee"] == 30.0
  kept, lost = sorted(("dof_damping:hip", "damping:hip"), key=lambda name: len(reasons[name]))
  assert reasons[kept] == ""
  assert reasons[lost] == f"the records identify it only together with {kept}"
  assert numbers(found)[lost] == 1.0
  # The sum of both is right.
  total = 0.1 * numbers(found)["dof_damping:hip"] + 0.5 * numbers(found)["damping:hip"]
  assert total == pytest.approx(0.1 * 2.0 + 0.5, rel=0.01)
  assert numbers(found)["dof_armature:hip"] == pytest.approx(1.6, rel=0.01)
  assert "hardly depend" in found.summary()


def test_contact_friction_is_found_where_a_foot_slides() -> None:
  robot = arm(pose={"hip": 0.3, "knee": -0.6}, floor=0.56)
  true = changed(robot, {"geom_friction:foot": 0.5})
  made = record(robot, true, sines(robot, 2, 1.0, size=0.05), noise=1e-5)
  found = fit(robot, [made], "geom_friction:foot", cfg=IdentifyCfg(window=0.1))
  assert all(estimate.identifiable for estimate in found.estimates)
  assert found.value("geom_friction.sliding:foot") == pytest.approx(0.5, rel=0.05)


def test_encoder_offsets_and_masses_are_found_through_gravity() -> None:
  robot = arm(pose={"hip": 0.5, "knee": 0.5})
  made = record(robot, changed(robot, {"body_mass:shank": 1.5}), sines(robot, 3, 1.0), bias=0.03)
  found = fit(robot, [made], "encoder_bias:.*,shared", "body_mass:shank")
  assert numbers(found)["encoder_bias:.*"] == pytest.approx(0.03, rel=0.03)
  assert numbers(found)["body_mass:shank"] == pytest.approx(1.5, rel=0.01)


@pytest.mark.parametrize("kind", ["ideal", "dc"])
def test_actuator_models_of_torch_are_fitted_too(kind: str) -> None:
  more: dict[str, Any] = {"target_names_expr": (".*",), "stiffness": 20.0, "damping": 0.5, "armature": 0.02}
  motor: dict[str, Any] = {"saturation_effort": 40.0, "velocity_limit": 200.0}
  robot = arm((IdealPdActuatorCfg(**more) if kind == "ideal" else DcMotorActuatorCfg(**more, **motor),))
  gains = np.array([26.0, 20.0])
  made = record(
    robot,
    changed(robot, {"dof_armature:knee": 1.5}),
    sines(robot, 0, 1.5),
    controller=lambda target, position, velocity: gains * (target - position) - 0.5 * velocity,
  )
  found = fit(robot, [made], "stiffness:hip", "armature:knee")
  agree(found, {"stiffness:hip": 1.3, "dof_armature:knee": 1.5}, 0.005)


def test_inertia_moves_as_one_and_stays_physical() -> None:
  robot = arm(pose={"hip": 0.4, "knee": 0.4})
  made = record(robot, changed(robot, {"body_mass:shank": 1.4, "body_inertia:shank": 1.4}), sines(robot, 0, 1.5))
  found = fit(robot, [made], "pseudo_inertia.alpha:shank")
  assert numbers(found)["pseudo_inertia.alpha:shank"] == pytest.approx(0.5 * np.log(1.4), rel=0.01)


def test_an_effort_limit_and_a_gain_are_found_where_the_limit_is_reached() -> None:
  robot = arm()
  true = changed(robot, {"actuator_forcerange:hip": 0.15, "damping:knee": 1.8})
  made = record(robot, true, sines(robot, 4, 1.0, size=0.4))
  found = fit(robot, [made], "effort_limit:hip=2..30", "damping:knee")
  # Nothing changes near the prior of 30, which is never reached.
  assert all(estimate.identifiable for estimate in found.estimates)
  agree(found, {"effort_limit:hip": 4.5, "damping:knee": 1.8}, 0.01)


def test_the_centre_of_mass_of_a_body_is_found_in_its_pseudo_inertia() -> None:
  robot = arm(pose={"hip": 0.4, "knee": 0.4})
  true, wanted = copy.copy(robot.model), {"alpha": 0.15, "t3": 0.02}
  randomize(true, [randomize_field("pseudo_inertia", "shank", {name: (x, x) for name, x in wanted.items()})], seed=0)
  made = record(robot, true, sines(robot, 0, 1.0))
  found = fit(robot, [made], "pseudo_inertia.alpha:shank", "pseudo_inertia.t3:shank")
  agree(found, {f"pseudo_inertia.{name}:shank": x for name, x in wanted.items()}, 0.03)
  centre = found.overlay["model"]["body_ipos"]["shank"]
  np.testing.assert_allclose(centre, true.body("shank").ipos, atol=1e-4)


def test_bounds_and_priors_are_those_of_the_task_s_randomisation() -> None:
  terms = [parse_term(text) for text in ("armature:hip", "armature:knee=0.01..0.09", "damping:.*,shared", "delay:hip")]
  found = Worlds(arm(), 1).bind(terms, {"dof_armature": ("scale", 1.2, 2.0), "delay": ("absolute", 0.0, 0.01)})
  shown = [(p.name, p.operation, p.lo, p.start, p.hi) for p in found]
  assert shown == [
    # The factor 1 is outside of the bounds, so that the prior is their middle.
    ("dof_armature:hip", "scale", 1.2, 1.6, 2.0),
    ("dof_armature:knee", "absolute", 0.01, 0.02, 0.09),
    ("damping:.*", "scale", 0.25, 1.0, 4.0),
    ("delay:hip", "absolute", 0.0, 0.0, 0.01),
  ]


def test_measured_efforts_identify_a_stiffness() -> None:
  robot = arm(pose={"hip": 0.4, "knee": 0.4})
  factors = {"stiffness:hip": 1.3}
  made = record(robot, changed(robot, factors), sines(robot, 0, 1.5), signals=("position", "effort"))
  agree(fit(robot, [made], "stiffness:hip"), factors, 0.005)


@pytest.mark.parametrize("factors", [{"dof_armature:hip": 1.6, "dof_frictionloss:hip": 3.0}, {"dof_armature:hip": 3.5}])
def test_cma_needs_no_gradient(factors: dict[str, float]) -> None:
  robot = arm()
  made = record(robot, changed(robot, factors), sines(robot, 0, 1.0))
  found = fit(robot, [made], *factors, cfg=IdentifyCfg(window=0.12, solver="cma", iterations=18))
  agree(found, factors, 0.02)


def test_a_fit_that_ends_early_returns_the_best_so_far() -> None:
  robot = arm()
  made = record(robot, changed(robot, FACTORS), sines(robot, 0, 1.0))
  found = fit(robot, [made], *TERMS, on_iteration=lambda progress: progress.iteration == 2)
  assert found.stopped
  assert all(after < before for before, after in (trace.errors for trace in found.traces))


@pytest.mark.parametrize(
  ("terms", "message"),
  [
    (["armature"], r"fit 'armature': expected FIELD\[\.AXIS\]:PATTERN"),
    (["armatur:.*"], "field 'armatur' does not exist. Nearest: armature"),
    (["geom_friction.slide:foot"], "axis 'slide' does not exist. Nearest: sliding"),
    (["armature:ankle"], "pattern 'ankle' matches no joint"),
    (["stiffness:ankle"], "pattern 'ankle' matches no driven joint"),
    (["armature:hip=2..1"], r"bounds 2\.\.1 must rise"),
    (["armature:hip", "dof_armature:.*"], "dof_armature of 'hip' is named twice"),
    (
      ["pseudo_inertia.alpha:shank", "body_mass:shank=0.1..1"],
      "body_mass of body 'shank' is also written by pseudo_inertia",
    ),
    (["armature:hip=-1..1"], "below the physical minimum 0"),
    (["geom_matid:foot"], "it is a choice"),
  ],
)
def test_a_wrong_parameter_is_refused_by_name(terms: list[str], message: str) -> None:
  robot = arm()
  made = record(robot, robot.model, sines(robot, 0, 1.0))
  with pytest.raises(MjlabError, match=message):
    fit(robot, [made], *terms)


def test_records_that_do_not_fit_the_robot_are_refused() -> None:
  robot = arm()
  made = record(robot, robot.model, sines(robot, 0, 1.0))
  for signals, joints, message in (
    ({**made.signals, "position": made.signals["position"] * 0.0 + 573.0}, made.joints, "name the unit"),
    (made.signals, ("hip", "ankle"), "joint 'ankle' does not exist"),
    ({"position": made.signals["position"]}, made.joints, "no joint has a command"),
    ({"position_target": made.signals["position"]}, made.joints, "joint 'hip' has no signal 'position'"),
  ):
    wrong = Record(source="test", joints=joints, time=made.time, signals=signals)
    with pytest.raises(MjlabError, match=message):
      fit(robot, [wrong], "armature:hip")
  with pytest.raises(MjlabError, match=r"windows of 5 s are longer than the records, of at most 0\.99 s"):
    fit(robot, [made], "armature:hip", cfg=IdentifyCfg(window=5.0))


def test_the_base_of_a_robot_on_its_stand_does_not_touch_its_limbs() -> None:
  robot = arm()
  assert robot.model.nv == 2
  assert robot.model.nexclude == 1


def test_a_killed_fit_is_resumed(tmp_path: Path) -> None:
  robot, file = arm(), tmp_path / "fit.json"
  made = record(robot, changed(robot, FACTORS), sines(robot, 0, 1.0))

  def kill(progress: Progress) -> None:
    if progress.iteration == 4:
      raise KeyboardInterrupt

  with pytest.raises(KeyboardInterrupt):
    fit(robot, [made], *TERMS, on_iteration=kill, progress=file)
  assert [path.name for path in tmp_path.iterdir()] == ["fit.json"]
  begun = file.read_text()
  costs: list[float] = []
  found = fit(robot, [made], *TERMS, resume=True, on_iteration=lambda seen: costs.append(seen.cost), progress=file)
  agree(found, FACTORS, 0.005)
  first: list[float] = []
  fit(robot, [made], *TERMS, on_iteration=lambda seen: first.append(seen.cost) or True)
  assert costs[0] < 0.5 * first[0]
  assert not file.exists()
  for content, message in (
    (begun.replace('"fit": "', '"fit": "0'), "of other records, parameters or settings; fit again without resuming"),
    (begun[:-20], r"fit\.json: "),
    ("{}", "expected an object with format 'mjlab sysid progress 1'"),
    (begun.replace('"x": [', '"x": [0.0, '), "expected 6 finite numbers"),
  ):
    file.write_text(content)
    with pytest.raises(MjlabError, match=message) as raised:
      fit(robot, [made], *TERMS, resume=True, progress=file)
    assert "\n" not in str(raised.value)


def test_an_imu_on_a_limb_identifies_its_damping_without_measured_velocities() -> None:
  robot = arm(imu="tip")
  factors = {"dof_damping:knee": 3.0, "body_mass:shank": 1.4}
  made = record(robot, changed(robot, factors), sines(robot, 0, 1.2), noise=2e-3, signals=("position", "imu"))
  found = fit(robot, [made], "viscous_damping:knee", "body_mass:shank")
  plain = fit(robot, [of_joints(made, "encoders")], "viscous_damping:knee", "body_mass:shank")
  agree(found, factors, 0.03)
  # The gyro and the accelerometer add information to that of encoders.
  assert (found.information.std < 0.7 * plain.information.std).all()
  assert {trace.joint for trace in found.traces} > {"hip", "angular_velocity/x [rad/s]"}
  with pytest.raises(MjlabError, match=r"site 'top' does not exist\. Nearest: tip"):
    arm(imu="top")
  held = arm(imu="trunk")
  with pytest.warns(UserWarning, match="linear_acceleration not compared: the model has no IMU on a body that moves"):
    fit(held, [made], "armature:hip", cfg=IdentifyCfg(iterations=1))


def test_a_moving_base_begins_each_window_at_its_measured_pose() -> None:
  robot = arm(is_free=True, floor=None)
  factors = {"body_mass:shank": 1.5, "dof_armature:knee": 1.6}
  made = record(robot, changed(robot, factors), sines(robot, 0, 1.0), noise=1e-4)
  found = fit(robot, [made], "body_mass:shank", "armature:knee", cfg=IdentifyCfg())
  agree(found, factors, 0.03)
  shown = {trace.joint: trace.errors for trace in found.traces}
  base = [f"base_{signal}" for axis in "xyz" for signal in (f"position/{axis} [m]", f"orientation/{axis} [rad]")]
  assert set(shown) == {"hip", "knee", *base}
  before, after = shown["base_orientation/y [rad]"]
  assert after < 3e-3 < before
  with pytest.raises(MjlabError, match=r"a\.csv: the base moves, so the record needs base_position and base_orient"):
    fit(robot, [of_joints(made, "a.csv")], "armature:knee")
