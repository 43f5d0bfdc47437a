"""Joints, tendons and sites: MuJoCo C applies each kind where its config says, along the right direction."""

import dataclasses
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from actuator_models import build
from mjlab_actuators import (
  ActuatorCfg,
  ActuatorSet,
  DcMotorActuatorCfg,
  IdealPdActuatorCfg,
  LearnedMlpActuatorCfg,
  NativeDcMotorActuatorCfg,
  NativeGeneralActuatorCfg,
  NativeMotorActuatorCfg,
  NativeMuscleActuatorCfg,
  NativePositionActuatorCfg,
  NativeVelocityActuatorCfg,
  Target,
  XmlActuatorCfg,
)

# The tendon and a joint share a name; so do a site and a body.
CRANE = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <site name="anchor" pos="0.3 -0.2 1.1" euler="20 30 40"/>
    <body name="hull" pos="0 0 1">
      <freejoint name="float"/>
      <geom size="0.1"/>
      <site name="keel" pos="0.1 0.05 -0.2" euler="10 -20 60"/>
      <body pos="0.2 0 0">
        <joint name="lift" axis="0 1 0" range="-50 70"/>
        <geom type="capsule" size="0.02" fromto="0 0 0 0.4 0 0.1"/>
        <body pos="0.4 0 0.1">
          <joint name="reach" type="slide" axis="1 0 0" range="-1 2"/>
          <geom size="0.05"/>
          <site name="hook" pos="0.1 0 -0.1" euler="-30 15 5"/>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="lift" range="-2 3"><joint joint="lift" coef="0.7"/><joint joint="reach" coef="-1.5"/></fixed>
    <spatial name="rope"><site site="keel"/><site site="hook"/></spatial>
  </tendon>
  %s
</mujoco>
"""
KP, KD = 4.0, 0.6
THRUST = (0.2, -0.3, 1.0, 0.01, 0.02, -0.05)
WORLDS = 3


def make(*cfgs: ActuatorCfg, own: str = "") -> tuple[mujoco.MjModel, ActuatorSet]:
  return build(CRANE % own, *cfgs, num_envs=WORLDS)


def moving(model: mujoco.MjModel) -> list[mujoco.MjData]:
  """The model in random states, one for each world."""
  random, worlds = np.random.default_rng(0), []
  for _ in range(WORLDS):
    data = mujoco.MjData(model)
    data.qpos[:] += 0.4 * random.standard_normal(model.nq)
    data.qpos[3:7] /= np.linalg.norm(data.qpos[3:7])
    data.qvel[:] = random.standard_normal(model.nv)
    mujoco.mj_forward(model, data)
    worlds.append(data)
  return worlds


def measured(actuators: ActuatorSet, worlds: list[mujoco.MjData]) -> tuple[torch.Tensor, torch.Tensor]:
  """Positions and velocities of the set's columns, as MuJoCo C has them, (WORLDS, columns) each."""
  outputs = iter(actuators.site_outputs)

  def both(data: mujoco.MjData, target: Target, output: int | None) -> tuple[float, float]:
    if target.transmission == "joint":
      joint = data.joint(target.name)
      return joint.qpos[0], joint.qvel[0]
    if target.transmission == "tendon":
      tendon = data.tendon(target.name)
      return tendon.length.item(), tendon.velocity.item()
    assert output is not None
    return data.actuator_length[output], data.actuator_velocity[output]

  found = [(target, next(outputs) if target.transmission == "site" else None) for target in actuators.targets]
  table = torch.tensor(np.array([[both(data, *column) for column in found] for data in worlds]))
  return table[..., 0], table[..., 1]


def random_targets(actuators: ActuatorSet) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
  generator = torch.Generator().manual_seed(1)
  position, velocity, effort = torch.randn(3, WORLDS, len(actuators.targets), generator=generator, dtype=torch.float64)
  return position, velocity, effort


def applied(model: mujoco.MjModel, actuators: ActuatorSet, ctrl: torch.Tensor) -> np.ndarray:
  """What MuJoCo C makes of the commands, (WORLDS, nv)."""
  forces = []
  for data, row in zip(moving(model), ctrl, strict=True):
    data.ctrl[list(actuators.ctrl_ids)] = row.numpy()
    mujoco.mj_forward(model, data)
    forces.append(data.qfrc_actuator.copy())
  return np.array(forces)


def tendon_row(model: mujoco.MjModel, data: mujoco.MjData, name: str) -> np.ndarray:
  """How joint velocities change the length of a tendon, (nv,)."""
  row = np.zeros(model.nv)
  if name == "lift":
    row[model.joint("lift").dofadr], row[model.joint("reach").dofadr] = 0.7, -1.5
    return row
  one, other = (data.site(site).xpos for site in ("keel", "hook"))
  jacobians = [np.zeros((3, model.nv)) for _ in range(2)]
  for jacobian, site in zip(jacobians, ("keel", "hook"), strict=True):
    mujoco.mj_jacSite(model, data, jacobian, None, model.site(site).id)
  return (other - one) / np.linalg.norm(other - one) @ (jacobians[1] - jacobians[0])


def site_row(model: mujoco.MjModel, data: mujoco.MjData, name: str, refsite: str | None) -> np.ndarray:
  """How joint velocities move a site along the wrench THRUST, of its own frame or of the reference's, (nv,)."""
  rows = {}
  for site in (name, refsite):
    if site is not None:
      rows[site] = np.zeros((6, model.nv))
      mujoco.mj_jacSite(model, data, rows[site][:3], rows[site][3:], model.site(site).id)
  frame = data.site(refsite or name).xmat.reshape(3, 3)
  relative = rows[name].copy()
  if refsite is not None:
    relative -= rows[refsite]
    # What carries both sites along moves neither against the other.
    relative[:, np.any(rows[name], axis=0) & np.any(rows[refsite], axis=0)] = 0.0
  return np.array(THRUST) @ np.vstack((frame.T @ relative[:3], frame.T @ relative[3:]))


MODELS: dict[str, Any] = {
  "position": NativePositionActuatorCfg(target_names_expr=("x",), stiffness=KP, damping=KD),
  "velocity": NativeVelocityActuatorCfg(target_names_expr=("x",), damping=KD),
  "motor": NativeMotorActuatorCfg(target_names_expr=("x",), gear=-2.0),
  "general": NativeGeneralActuatorCfg(
    target_names_expr=("x",),
    command_field="effort_target",
    gain_prm=(3.0,),
    bias_type="affine",
    bias_prm=(0.5, -KP, -KD),
  ),
  "dc": NativeDcMotorActuatorCfg(target_names_expr=("x",), torque_constant=0.5, resistance=2.0),
  "pd": IdealPdActuatorCfg(target_names_expr=("x",), stiffness=KP, damping=KD, effort_limit=1.5),
  "dc_pd": DcMotorActuatorCfg(
    target_names_expr=("x",), stiffness=KP, damping=KD, saturation_effort=2.0, velocity_limit=3.0
  ),
}


def force(kind: str, numbers: list[Any]) -> Any:
  """Closed form of MODELS, per unit of transmission length, of three targets, position and velocity."""
  target, rate, effort, q, v = numbers
  pd = KP * (target - q) + KD * (rate - v) + effort
  return {
    "position": KP * (target - q) - KD * v,
    "velocity": KD * (rate - v),
    "motor": effort,
    "general": 3.0 * effort + 0.5 - KP * q - KD * v,
    "dc": 0.5 * (effort - 0.5 * v) / 2.0,
    "pd": np.clip(pd, -1.5, 1.5),
    "dc_pd": np.clip(pd, -np.clip(2.0 + v / 1.5, 0.0, None), np.clip(2.0 - v / 1.5, 0.0, None)),
  }[kind]


WHERE: dict[str, dict[str, Any]] = {
  "fixed tendon": {"target_names_expr": ("lift",), "transmission_type": "tendon"},
  "spatial tendon": {"target_names_expr": ("rope",), "transmission_type": "tendon"},
  "site against another": {
    "target_names_expr": ("hook",),
    "transmission_type": "site",
    "site_gear": THRUST,
    "refsite": "keel",
  },
  "site against the world": {
    "target_names_expr": ("keel",),
    "transmission_type": "site",
    "site_gear": THRUST,
    "refsite": "anchor",
  },
}


@pytest.mark.parametrize("where", WHERE)
@pytest.mark.parametrize("kind", MODELS)
def test_mujoco_applies_the_closed_form_along_the_transmission(kind: str, where: str) -> None:
  cfg = dataclasses.replace(MODELS[kind], **WHERE[where])
  model, actuators = make(cfg)
  worlds = moving(model)
  position, velocity = measured(actuators, worlds)
  targets = random_targets(actuators)
  got = applied(model, actuators, actuators.compute(*targets, position, velocity))
  column = [target.transmission for target in actuators.targets].index(cfg.transmission_type)
  for world, data in enumerate(worlds):
    name = cfg.target_names_expr[0]
    row = (
      tendon_row(model, data, name) if cfg.transmission_type == "tendon" else site_row(model, data, name, cfg.refsite)
    )
    numbers = [tensor[world, column].numpy() for tensor in (*targets, position, velocity)]
    # A geared transmission is as much longer; only models inside MuJoCo have a gear.
    if kind != "motor":
      assert row @ data.qvel == pytest.approx(numbers[-1])
    np.testing.assert_allclose(got[world], row * force(kind, numbers), rtol=1e-9, atol=1e-9)


def test_a_site_without_a_reference_is_pushed_by_a_wrench_in_its_frame() -> None:
  site: dict[str, Any] = {"transmission_type": "site", "site_gear": {"keel": THRUST, "h.*": (1, 0, 0, 0, 0, 0)}}
  thrusters = NativeMotorActuatorCfg(target_names_expr=("keel", "hook"), effort_limit=0.8, gear=3.0, **site)
  model, actuators = make(thrusters)
  _, _, effort = targets = random_targets(actuators)
  got = applied(model, actuators, actuators.compute(*targets, effort, effort))
  assert actuators.driven("site") == ("keel", "hook")
  for world, data in enumerate(moving(model)):
    column = actuators.targets.index(Target("site", "keel"))
    pushed = effort[world, column].clamp(-2.4, 2.4).item() * site_row(model, data, "keel", None)
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, jacobian, None, model.site("hook").id)
    along_x = data.site("hook").xmat.reshape(3, 3)[:, 0] @ jacobian
    pushed += effort[world, column + 1].clamp(-2.4, 2.4).item() * along_x
    np.testing.assert_allclose(got[world], pushed, rtol=1e-9, atol=1e-9)


def test_a_damper_works_on_a_site_without_a_reference() -> None:
  cfg = IdealPdActuatorCfg(
    target_names_expr=("keel",), transmission_type="site", site_gear=THRUST, stiffness=0.0, damping=KD
  )
  model, actuators = make(cfg)
  worlds = moving(model)
  zero = torch.zeros(WORLDS, len(actuators.targets), dtype=torch.float64)
  got = applied(model, actuators, actuators.compute(zero, zero, zero, *measured(actuators, worlds)))
  for world, data in enumerate(worlds):
    row = site_row(model, data, "keel", None)
    np.testing.assert_allclose(got[world], -KD * (row @ data.qvel) * row, rtol=1e-9, atol=1e-9)


def test_a_muscle_pulls_along_a_tendon_and_takes_its_range() -> None:
  cfg = NativeMuscleActuatorCfg(target_names_expr=("lift",), transmission_type="tendon", force=20.0)
  model, actuators = make(cfg)
  np.testing.assert_allclose(model.actuator_lengthrange, [[-2.0, 3.0]])
  data = mujoco.MjData(model)
  # A quarter of the way from 0.75 to 1.05 of the optimal length, per 5 m of tendon, is one.
  length = -2.0 + 0.25 * 5.0 / 0.3
  data.joint("lift").qpos[:] = length / 0.7
  data.act[:] = 0.4
  targets = torch.full((WORLDS, len(actuators.targets)), 0.3, dtype=torch.float64)
  data.ctrl[:] = actuators.compute(*[targets] * 5)[0].numpy()
  mujoco.mj_forward(model, data)
  assert data.tendon("lift").length == pytest.approx(length)
  np.testing.assert_allclose(data.qfrc_actuator, -20.0 * 0.4 * tendon_row(model, data, "lift"), atol=1e-9)


OWN = """<actuator>
  <position name="winch" tendon="lift" kp="3" kv="0.2"/>
  <motor name="push" site="hook" gear="0 0 2 0 0 .3"/>
  <position name="stay" site="keel" refsite="anchor" gear="1 0 0 0 0 0" kp="2"/>
  <velocity name="spin" joint="lift" kv="2"/>
</actuator>"""


def test_actuators_of_the_mjcf_are_wrapped_unchanged_on_every_transmission() -> None:
  plain = mujoco.MjModel.from_xml_string(CRANE % OWN)
  wrapped = [XmlActuatorCfg(target_names_expr=(".*",), transmission_type=kind) for kind in ("joint", "tendon", "site")]
  model, actuators = make(*wrapped, own=OWN)
  for field in ("gainprm", "biasprm", "gear", "trntype", "trnid", "ctrlrange", "forcerange"):
    np.testing.assert_array_equal(getattr(model, f"actuator_{field}"), getattr(plain, f"actuator_{field}"))
  targets = random_targets(actuators)
  ctrl = actuators.compute(*targets, *targets[:2])
  fields = {"winch": 0, "push": 2, "stay": 0, "spin": 1}
  columns = {
    "winch": Target("tendon", "lift"),
    "push": Target("site", "hook"),
    "stay": Target("site", "keel"),
    "spin": Target("joint", "lift"),
  }
  for name, field in fields.items():
    column = actuators.targets.index(columns[name])
    assert torch.equal(ctrl[:, model.actuator(name).id], targets[field][:, column]), name


def test_a_configured_site_is_measured_by_the_added_actuator_beside_one_of_the_mjcf() -> None:
  cfg = IdealPdActuatorCfg(
    target_names_expr=("keel",), transmission_type="site", site_gear=THRUST, stiffness=0.0, damping=1.0
  )
  model, actuators = make(XmlActuatorCfg(target_names_expr=("lift",)), cfg, own=OWN)
  assert [model.actuator(output).name for output in actuators.site_outputs] == ["keel"]


def test_a_tendon_and_a_joint_of_one_name_are_two_targets() -> None:
  cfgs = [
    dataclasses.replace(MODELS["pd"], target_names_expr=("lift",), transmission_type=kind)
    for kind in ("joint", "tendon")
  ]
  for order in (cfgs, cfgs[::-1]):
    model, actuators = make(*order)
    assert {model.actuator(i).name for i in range(2)} == {"lift", "lift_joint" if order is not cfgs else "lift_tendon"}
    # One kind, one computation, whatever it acts on.
    assert len(actuators.groups) == 1
    worlds = moving(model)
    targets, (position, velocity) = random_targets(actuators), measured(actuators, worlds)
    got = applied(model, actuators, actuators.compute(*targets, position, velocity))
    for world, data in enumerate(worlds):
      expected = np.zeros(model.nv)
      for target, row in (
        (Target("joint", "lift"), np.eye(model.nv)[model.joint("lift").dofadr[0]]),
        (Target("tendon", "lift"), tendon_row(model, data, "lift")),
      ):
        column = actuators.targets.index(target)
        expected += row * force("pd", [x[world, column].numpy() for x in (*targets, position, velocity)])
      np.testing.assert_allclose(got[world], expected, rtol=1e-9, atol=1e-9)


def test_passive_properties_are_written_on_the_tendon() -> None:
  passive: dict[str, Any] = {"armature": 0.1, "frictionloss": {"li.*": 0.2}, "viscous_damping": 0.3}
  model, _ = make(NativeMotorActuatorCfg(target_names_expr=(".*",), transmission_type="tendon", **passive))
  np.testing.assert_array_equal(model.tendon_armature, [0.1, 0.1])
  np.testing.assert_array_equal(model.tendon_frictionloss, [0.2, 0.0])
  np.testing.assert_array_equal(model.tendon_damping, [0.3, 0.3])
  assert not model.dof_frictionloss.any()


SITE: dict[str, Any] = {"target_names_expr": ("keel",), "transmission_type": "site"}


@pytest.mark.parametrize(
  ("kind", "where", "message"),
  [
    ("motor", {"target_names_expr": ("rope",)}, "pattern 'rope' matches no joint.* There is a tendon 'rope': "),
    ("motor", {"target_names_expr": ("hook",)}, "There is a site 'hook': transmission_type='site'"),
    ("motor", {"transmission_type": "tendn"}, "transmission_type 'tendn' does not exist. Nearest: tendon"),
    ("motor", {"transmission_type": "tendon", "target_names_expr": ("rop",)}, "matches no tendon. Nearest: rope"),
    ("motor", SITE, "NativeMotorActuatorCfg: site_gear is missing"),
    ("motor", SITE | {"site_gear": (0, 0, 1)}, "site_gear must have 6 elements"),
    ("motor", SITE | {"site_gear": (0,) * 6}, "site_gear of site 'keel' is all zero"),
    ("motor", SITE | {"site_gear": {"hook": THRUST}}, "pattern 'hook' matches no site"),
    ("motor", SITE | {"site_gear": THRUST, "refsite": "anchr"}, "refsite 'anchr' does not exist. Nearest: anchor"),
    ("motor", SITE | {"site_gear": THRUST, "armature": 0.1}, "armature is given, but transmission_type is 'site'"),
    ("motor", {"target_names_expr": ("lift",), "site_gear": THRUST}, "site_gear is given, but transmission_type is"),
    ("motor", {"target_names_expr": ("lift",), "refsite": "keel"}, "refsite is given, but transmission_type is"),
    *(
      (kind, SITE | {"site_gear": THRUST}, "site 'keel' has a position only relative to a refsite")
      for kind in ("position", "general", "pd", "dc_pd")
    ),
  ],
)
def test_impossible_transmissions_are_refused_by_name_at_build(kind: str, where: dict[str, Any], message: str) -> None:
  with pytest.raises(ValueError, match=message):
    make(dataclasses.replace(MODELS[kind], **where))


def test_models_that_read_a_position_need_a_reference_on_a_site() -> None:
  for cfg in (
    NativeMuscleActuatorCfg(site_gear=THRUST, length_range=(0.0, 1.0), **SITE),
    LearnedMlpActuatorCfg(site_gear=THRUST, network_file="unread.pt", **SITE),
    NativeDcMotorActuatorCfg(
      site_gear=THRUST, torque_constant=1.0, resistance=1.0, inputs=("position_target",), stiffness=1.0, **SITE
    ),
  ):
    with pytest.raises(ValueError, match="site 'keel' has a position only relative to a refsite"):
      make(cfg)


def test_a_muscle_on_an_unlimited_tendon_needs_its_range() -> None:
  with pytest.raises(ValueError, match="tendon 'rope' is not limited, so length_range must be given"):
    make(NativeMuscleActuatorCfg(target_names_expr=("rope",), transmission_type="tendon", force=1.0))


def test_several_wrapped_wrenches_on_one_site_are_refused_by_name() -> None:
  own = '<actuator><motor site="hook" gear="1 0 0 0 0 0"/><motor site="hook" gear="0 1 0 0 0 0"/></actuator>'
  with pytest.raises(ValueError, match="site 'hook' has one effort_target, but several actuators that take one"):
    make(XmlActuatorCfg(target_names_expr=("hook",), transmission_type="site"), own=own)


def test_the_direction_of_a_wrapped_site_is_the_mjcf_s() -> None:
  with pytest.raises(ValueError, match="XmlActuatorCfg: site_gear is given, but the MJCF has it already"):
    make(XmlActuatorCfg(target_names_expr=("hook",), transmission_type="site", site_gear=THRUST), own=OWN)


def test_an_invalid_pattern_is_refused_on_every_transmission() -> None:
  with pytest.raises(ValueError, match="is not a regular expression"):
    make(NativeMotorActuatorCfg(target_names_expr=("(",), transmission_type="tendon"))
