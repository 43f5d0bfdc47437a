"""Every kind of actuator in one entity, on both engines."""

import json
from pathlib import Path
from typing import Any

import mujoco
import pytest
import torch
from mjlab_actuators import (
  UNITREE_ENVELOPES,
  ActuatorCfg,
  DcMotorActuatorCfg,
  EnvelopedPdActuatorCfg,
  IdealPdActuatorCfg,
  LearnedMlpActuatorCfg,
  NativeDcMotorActuatorCfg,
  NativeGeneralActuatorCfg,
  NativeMotorActuatorCfg,
  NativeMuscleActuatorCfg,
  NativePdActuatorCfg,
  NativePositionActuatorCfg,
  NativeVelocityActuatorCfg,
  XmlActuatorCfg,
)
from mjlab_scene import EntityArticulationCfg, EntityCfg, InitialStateCfg, Scene, SceneCfg
from scene_models import MakeWorlds, entity

KINDS = "xml servo native_pd speed torque muscle general native_dc pd dc envelope network".split()


GAINS: dict[str, Any] = {"stiffness": 5.0, "damping": 0.1}


def hand() -> mujoco.MjSpec:
  """One body with a finger per kind of actuator; that of the MJCF's own has its actuator already."""
  fingers = "".join(
    f'<body pos="0 {k} 0"><joint name="{name}" axis="0 1 0" range="-90 90" armature="0.01"/>'
    f'<geom type="capsule" size="0.02" fromto="0 0 0 0.2 0 0"/></body>'
    for k, name in enumerate(KINDS)
  )
  return mujoco.MjSpec.from_string(
    f'<mujoco><worldbody><body name="palm">{fingers}</body></worldbody>'
    '<actuator><position name="own" joint="xml" kp="5" kv="0.1"/></actuator></mujoco>'
  )


def all_kinds(network: Path) -> tuple[ActuatorCfg, ...]:
  torch.manual_seed(0)
  net = torch.nn.Sequential(torch.nn.Linear(6, 8), torch.nn.Softsign(), torch.nn.Linear(8, 1))
  torch.save(net.state_dict(), network)
  late: dict[str, Any] = {"delay_min_lag": 2, "delay_max_lag": 2}
  affine: dict[str, Any] = {"gain_prm": (5.0,), "bias_type": "affine", "bias_prm": (0.0, -5.0, -0.1)}
  motor: dict[str, Any] = {"torque_constant": 0.5, "resistance": 2.0}
  inputs = ("position_target", "velocity_target")
  return (
    LearnedMlpActuatorCfg(target_names_expr=("network",), network_file=network, effort_limit=2.0, sample_period=0.002),
    XmlActuatorCfg(target_names_expr=("xml",), **late),
    NativePositionActuatorCfg(target_names_expr=("servo",), **GAINS, **late),
    NativePdActuatorCfg(target_names_expr=("native_pd",), effort_limit=2.0, **GAINS, **late),
    NativeVelocityActuatorCfg(target_names_expr=("speed",), damping=0.5),
    NativeMotorActuatorCfg(target_names_expr=("torque",), effort_limit=1.0),
    NativeMuscleActuatorCfg(target_names_expr=("muscle",), force=5.0),
    NativeGeneralActuatorCfg(
      target_names_expr=("general",), command_field="position_target", dyn_type="filterexact", dyn_prm=(0.02,), **affine
    ),
    NativeDcMotorActuatorCfg(target_names_expr=("native_dc",), inputs=inputs, voltage_limit=24.0, **GAINS, **motor),
    IdealPdActuatorCfg(target_names_expr=("pd",), **GAINS, **late),
    DcMotorActuatorCfg(target_names_expr=("dc",), saturation_effort=2.0, velocity_limit=8.0, **GAINS, **late),
    EnvelopedPdActuatorCfg(target_names_expr=("envelope",), envelope=UNITREE_ENVELOPES["W4010-25"], **GAINS),
  )


def trajectory(make_worlds: MakeWorlds, path: Path, engine: str, *, resets: bool) -> torch.Tensor:
  """Joint angles of two worlds over 20 substeps, the first of which may reset in the middle, (20, 2, joints)."""
  robot = EntityCfg(spec_fn=hand, articulation=EntityArticulationCfg(actuators=all_kinds(path)))
  scene, sim = make_worlds(2, engine, robot=robot)
  hand_of = scene["robot"]
  angles = []
  for substep in range(20):
    if substep == 10:
      mask = torch.tensor([resets, False])
      sim.reset(mask)
      scene.reset(mask)
      scene.write_default_state(mask)
    targets = torch.linspace(0.2, 0.8, 2, dtype=sim.dtype)[:, None].expand(2, len(KINDS)) * (1.0 + 0.1 * substep)
    hand_of.set_joint_position_target(targets)
    hand_of.set_joint_velocity_target(targets)
    hand_of.set_joint_effort_target(targets)
    scene.write_ctrl()
    sim.step()
    scene.update(sim.timestep)
    angles.append(hand_of.data.joint_pos.double().clone())
  return torch.stack(angles)


@pytest.mark.warp
def test_every_kind_drives_its_joint_alike_on_both_engines_and_a_reset_stays_in_its_world(
  make_worlds: MakeWorlds, tmp_path: Path
) -> None:
  restarts = []
  for engine in ("native", "warp"):
    plain, restarted = (trajectory(make_worlds, tmp_path / "n.pt", engine, resets=resets) for resets in (False, True))
    moved = plain[-1].abs().amin(dim=0)
    assert dict(zip(KINDS, (moved > 1e-3).tolist(), strict=True)) == dict.fromkeys(KINDS, True)
    assert torch.equal(plain[:, 1], restarted[:, 1])
    assert torch.equal(plain[:10, 0], restarted[:10, 0])
    assert (restarted[10, 0] - plain[10, 0]).abs().amax() > 1e-3
    restarts.append(restarted)
  torch.testing.assert_close(restarts[1], restarts[0], rtol=1e-3, atol=1e-4)


GEARED = """<mujoco><option gravity="0 0 0"/><worldbody>
  <body><joint name="j" axis="0 1 0"/><geom size=".1"/></body><body pos="0 1 0"><joint name="k" axis="0 1 0"/>
  <geom size=".1"/></body></worldbody>{}</mujoco>"""
SERVO: dict[str, Any] = {"target_names_expr": ("j",), "stiffness": 50.0, "damping": 4.0}
MOTOR: dict[str, Any] = SERVO | {"torque_constant": 0.5, "resistance": 0.1, "gear": 2.0}
AFFINE: dict[str, Any] = {"bias_type": "affine", "bias_prm": (0.0, -12.0, -1.0), "gear": 2.0}
XML = XmlActuatorCfg(target_names_expr=("j",))
RESTING: dict[str, tuple[ActuatorCfg, str, list[float]]] = {
  "position": (NativePositionActuatorCfg(**SERVO), "", [0.5]),
  "dc motor": (NativeDcMotorActuatorCfg(inputs=("position_target",), **MOTOR), "", [0.5]),
  "dc motor, two inputs": (
    NativeDcMotorActuatorCfg(inputs=("velocity_target", "position_target"), **MOTOR),
    "",
    [0.5, 0.0],
  ),
  "general": (
    NativeGeneralActuatorCfg(target_names_expr=("j",), command_field="position_target", gain_prm=(12.0,), **AFFINE),
    "",
    [1.0],
  ),
  "MJCF position": (XML, '<position joint="j" kp="12" kv="1" gear="2"/>', [1.0]),
  "MJCF pid": (XML, '<pid joint="j" kp="12" kv="1" input="pos vel ff" gear="2"/>', [1.0, 0.0, 0.0]),
  "MJCF dc motor": (
    XML,
    '<dcmotor joint="j" motorconst=".5" resistance=".1" input="pos vel" gear="2" controller="12 0 1"/>',
    [1.0, 0.0],
  ),
}


@pytest.mark.parametrize("kind", RESTING)
def test_controls_of_the_keyframe_hold_the_initial_pose_at_any_gear(kind: str) -> None:
  """One number per input, so that actuators behind one with several keep theirs."""
  cfg, own, expected = RESTING[kind]
  other = NativePositionActuatorCfg(target_names_expr=("k",), stiffness=50.0, damping=4.0)
  arm = entity(
    GEARED.format(f"<actuator>{own}</actuator>"),
    articulation=EntityArticulationCfg(actuators=(cfg, other)),
    init_state=InitialStateCfg(joint_pos={"j": 0.5, "k": -0.3}),
  )
  model = Scene(SceneCfg(entities={"arm": arm})).spec.compile()
  assert model.key_ctrl[0].tolist() == [*expected, -0.3]
  data = mujoco.MjData(model)
  mujoco.mj_resetDataKeyframe(model, data, 0)
  for _ in range(500):
    mujoco.mj_step(model, data)
  assert data.qpos.tolist() == pytest.approx([0.5, -0.3], abs=1e-9)


def test_an_overlay_limits_single_joints_of_a_config_without_limits(tmp_path: Path) -> None:
  values = {"effort_limit": {"j": 3.0}, "stiffness": {"k": 7.0}}
  (tmp_path / "identified.json").write_text(json.dumps({"format": "mjlab overlay 1", "actuators": values}))
  servos = NativePositionActuatorCfg(target_names_expr=(".*",), stiffness=50.0, damping=4.0)
  articulation = EntityArticulationCfg(actuators=(servos,))
  arm = entity(GEARED.format(""), articulation=articulation, overlay=str(tmp_path / "identified.json"))
  model = arm.build("arm").spec.compile()
  assert model.actuator_forcelimited.tolist() == [1, 0]
  assert model.actuator_forcerange[0].tolist() == [-3.0, 3.0]
  assert model.actuator_gainprm[:, 0].tolist() == [50.0, 7.0]
