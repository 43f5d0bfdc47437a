"""All tiers of actuators on joints, tendons and sites of one entity."""

from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from mjlab_actuators import (
  ActuatorCfg,
  IdealPdActuatorCfg,
  NativeMotorActuatorCfg,
  NativePositionActuatorCfg,
  XmlActuatorCfg,
)
from mjlab_scene import EntityArticulationCfg, InitialStateCfg
from scene_models import MakeWorlds, entity

FINGERS = "".join(
  f'<body pos="0 {k} 0"><joint name="{name}" axis="0 1 0" damping="0.1" armature="0.002" ref="10"/>'
  f'<geom type="capsule" size="0.02" density="100" fromto="0 0 0 0.2 0 0"/>'
  f'<site name="tip_{name}" pos="0.2 0.1 0" euler="30 {10 * k} 0"/></body>'
  for k, name in enumerate("abcdef")
)
CRANE = f"""
<mujoco>
  <worldbody>
    <body name="post"><site name="anchor" pos="0.1 0 0.5" euler="0 20 0"/>{FINGERS}</body>
  </worldbody>
  <tendon>
    <fixed name="xml"><joint joint="a" coef="1.5"/></fixed>
    <spatial name="servo"><site site="anchor"/><site site="tip_b"/></spatial>
    <fixed name="pd"><joint joint="c" coef="0.5"/><joint joint="d" coef="-2"/></fixed>
  </tendon>
  <actuator>
    <position name="own_joint" joint="d" kp="2" kv="0.1"/>
    <position name="own_tendon" tendon="xml" kp="2" kv="0.1"/>
    <motor name="own_site" site="tip_d" gear="0 1 0 0 0 0.2"/>
  </actuator>
</mujoco>
"""
TARGET_NAMES = {
  "joint": ("position", "velocity", "effort"),
  "tendon": ("len", "vel", "effort"),
  "site": ("pos", "vel", "effort"),
}
COLUMNS = {
  "joint": tuple("abcdef"),
  "tendon": ("xml", "servo", "pd"),
  "site": ("anchor", *(f"tip_{name}" for name in "abcdef")),
}
WRENCH = (1.0, 0.5, -0.5, 0.1, 0.0, 0.2)
GAINS: dict[str, Any] = {"stiffness": 3.0, "damping": 0.2}
LAG = 2
SUBSTEPS = 25


def all_transmissions() -> tuple[ActuatorCfg, ...]:
  """Every tier on every transmission; the third tier late by LAG substeps."""
  late: dict[str, Any] = {"delay_min_lag": LAG, "delay_max_lag": LAG}
  site: dict[str, Any] = {"transmission_type": "site", "site_gear": WRENCH}
  return (
    XmlActuatorCfg(target_names_expr=("d",)),
    XmlActuatorCfg(target_names_expr=("xml",), transmission_type="tendon"),
    XmlActuatorCfg(target_names_expr=("tip_d",), transmission_type="site"),
    NativePositionActuatorCfg(target_names_expr=("e",), **GAINS),
    NativePositionActuatorCfg(target_names_expr=("servo",), transmission_type="tendon", **GAINS),
    NativePositionActuatorCfg(target_names_expr=("tip_c",), refsite="anchor", **site, **GAINS),
    NativeMotorActuatorCfg(target_names_expr=("tip_e",), **site),
    IdealPdActuatorCfg(target_names_expr=("f",), **GAINS, **late),
    IdealPdActuatorCfg(target_names_expr=("pd",), transmission_type="tendon", **GAINS, **late),
    IdealPdActuatorCfg(target_names_expr=("tip_f",), refsite="anchor", **site, **GAINS, **late),
  )


def commands(kind: str, substep: int, world: int) -> np.ndarray:
  """Position, velocity and effort targets of one kind, (3, targets)."""
  return 0.5 * np.sin(0.3 * substep + np.arange(3)[:, None] + 0.7 * np.arange(len(COLUMNS[kind])) + world)


def in_c(model: mujoco.MjModel, world: int, substeps: int) -> np.ndarray:
  """What plain MuJoCo C does with the same commands, models of the third tier written out, (substeps, joints)."""
  data, angles = mujoco.MjData(model), []
  mujoco.mj_forward(model, data)

  def measured(kind: str, name: str) -> np.ndarray:
    if kind == "joint":
      return np.concatenate((data.joint(name).qpos, data.joint(name).qvel))
    if kind == "tendon":
      return np.concatenate((data.tendon(name).length, data.tendon(name).velocity))
    output = model.actuator(name).id
    return np.array((data.actuator_length[output], data.actuator_velocity[output]))

  def target(kind: str, name: str, field: int, substep: int) -> float:
    return commands(kind, substep, world)[field, COLUMNS[kind].index(name)]

  handed_over = {
    "own_joint": ("joint", "d", 0),
    "own_tendon": ("tendon", "xml", 0),
    "own_site": ("site", "tip_d", 2),
    "e": ("joint", "e", 0),
    "servo": ("tendon", "servo", 0),
    "tip_c": ("site", "tip_c", 0),
    "tip_e": ("site", "tip_e", 2),
  }
  computed = {"f": "joint", "pd": "tendon", "tip_f": "site"}
  assert len(handed_over) + len(computed) == model.nu
  start = {name: measured(kind, f"robot/{name}")[0] for name, kind in computed.items()}
  for substep in range(substeps):
    mujoco.mj_step1(model, data)
    for element, (kind, name, field) in handed_over.items():
      data.actuator(f"robot/{element}").ctrl[:] = target(kind, name, field, substep)
    for name, kind in computed.items():
      wanted = [start[name], 0.0, 0.0]
      if substep >= LAG:
        wanted = [target(kind, name, field, substep - LAG) for field in range(3)]
      position, velocity = measured(kind, f"robot/{name}")
      effort = GAINS["stiffness"] * (wanted[0] - position) + GAINS["damping"] * (wanted[1] - velocity) + wanted[2]
      data.actuator(f"robot/{name}").ctrl[:] = effort
    mujoco.mj_step2(model, data)
    angles.append(data.qpos.copy())
  return np.array(angles)


@pytest.mark.parametrize(
  ("engine", "tolerance"), [("native", 1e-10), pytest.param("warp", 1e-4, marks=pytest.mark.warp)]
)
def test_all_tiers_on_all_transmissions_move_one_robot_as_mujoco_c_does(
  make_worlds: MakeWorlds, engine: str, tolerance: float
) -> None:
  cfg = entity(CRANE, articulation=EntityArticulationCfg(actuators=all_transmissions()))
  scene, sim = make_worlds(2, engine, robot=cfg)
  robot = scene["robot"]
  for substep in range(SUBSTEPS):
    for kind, names in TARGET_NAMES.items():
      rows = torch.tensor(np.array([commands(kind, substep, world) for world in range(2)]), dtype=sim.dtype)
      for name, value in zip(names, rows.unbind(1), strict=True):
        getattr(robot, f"set_{kind}_{name}_target")(value)
    scene.write_ctrl()
    sim.step()
  for world in range(2):
    expected = in_c(sim.mj_model, world, SUBSTEPS)
    assert np.abs(expected[-1] - expected[0]).min() > 0.01
    np.testing.assert_allclose(robot.data.joint_pos[world].double().numpy(), expected[-1], atol=tolerance)


@pytest.mark.parametrize("lag", [0, 3])
def test_a_fresh_world_holds_its_default_pose_and_lengths_until_targets_change(
  make_worlds: MakeWorlds, lag: int
) -> None:
  late: dict[str, Any] = {"delay_min_lag": lag, "delay_max_lag": lag}
  cfg = entity(
    CRANE,
    init_state=InitialStateCfg(joint_pos={"[ab]": 0.4, "c": -0.3}),
    articulation=EntityArticulationCfg(
      actuators=(
        NativePositionActuatorCfg(target_names_expr=("a", "b"), **GAINS, **late),
        NativePositionActuatorCfg(target_names_expr=("pd", "servo"), transmission_type="tendon", **GAINS, **late),
        IdealPdActuatorCfg(
          target_names_expr=("tip_c",), transmission_type="site", site_gear=WRENCH, refsite="anchor", **GAINS, **late
        ),
      )
    ),
  )
  scene, sim = make_worlds(2, robot=cfg)
  robot = scene["robot"]
  for target in ("len", "vel", "effort"):
    getattr(robot, f"set_tendon_{target}_target")(torch.full((2, 3), 9.0))
    getattr(robot, f"set_site_{target.replace('len', 'pos')}_target")(torch.full((2, 7), 9.0))
  for _ in range(2 * lag + 1):
    scene.write_ctrl()
    sim.step()
  driven = sim.data.ctrl.clone()
  mask = torch.tensor([False, True])
  sim.reset(mask)
  scene.reset(mask)
  scene.write_default_state(mask)
  other = sim.data.ctrl[0].clone()
  scene.write_ctrl()
  model, start = sim.mj_model, mujoco.MjData(sim.mj_model)
  start.qpos[:] = sim.data.qpos[1].numpy()
  mujoco.mj_forward(model, start)
  for name in ("servo", "pd"):
    assert sim.data.ctrl[1, model.actuator(f"robot/{name}").id] == pytest.approx(
      start.tendon(f"robot/{name}").length.item()
    )
  for name in ("a", "b"):
    assert sim.data.ctrl[1, model.actuator(f"robot/{name}").id] == pytest.approx(0.4)
  # Where the site is, no force is needed.
  assert sim.data.ctrl[1, model.actuator("robot/tip_c").id].item() == pytest.approx(0.0, abs=1e-12)
  assert (driven[1, model.actuator("robot/tip_c").id]).abs() > 1.0
  assert torch.equal(other, driven[0])


def test_targets_without_an_actuator_are_refused_by_name(make_worlds: MakeWorlds) -> None:
  motor = NativeMotorActuatorCfg(target_names_expr=("a",))
  cfg = entity(CRANE, articulation=EntityArticulationCfg(actuators=(motor,)))
  scene, _ = make_worlds(2, robot=cfg, plain=CRANE)
  for name in ("robot", "plain"):
    with pytest.raises(ValueError, match=f"entity '{name}': tendon position target: no actuator config drives a"):
      scene[name].set_tendon_len_target(torch.zeros(2, 3))
    with pytest.raises(ValueError, match=f"entity '{name}': site effort target: no actuator config drives a site"):
      scene[name].set_site_effort_target(torch.zeros(2, 7))


def test_targets_of_chosen_tendons_reach_masked_worlds_only(make_worlds: MakeWorlds) -> None:
  cfg = entity(CRANE, articulation=EntityArticulationCfg(actuators=all_transmissions()))
  scene, _ = make_worlds(2, robot=cfg)
  robot = scene["robot"]
  ids, names = robot.find_tendons(("servo", "xml"), preserve_order=True)
  assert names == ["servo", "xml"]
  before = robot.data.tendon_vel_target.clone()
  robot.set_tendon_vel_target(torch.tensor([[1.0, 2.0]]), tendon_ids=ids, mask=torch.tensor([False, True]))
  assert torch.equal(robot.data.tendon_vel_target[0], before[0])
  assert robot.data.tendon_vel_target[1].tolist() == [2.0, 1.0, 0.0]
  with pytest.raises(ValueError, match=r"tendon velocity target: shape \(2, 2\) does not fit \(2, 3\)"):
    robot.set_tendon_vel_target(torch.zeros(2, 2))
