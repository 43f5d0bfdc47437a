"""Agreement of MuJoCo C, the native engine and MuJoCo Warp."""

import copy
import operator
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from mjlab_sim import PER_WORLD, Simulation, TorchArray
from sim_world import NUM_WORLDS, MakeSim, assert_same, reference, scatter

POSITION = """xpos xquat xmat xipos ximat geom_xpos geom_xmat site_xpos site_xmat cam_xpos cam_xmat xanchor xaxis
subtree_com ten_length actuator_length""".split()
VELOCITY = "cvel ten_velocity actuator_velocity qfrc_bias qfrc_passive cdof cdof_dot cinert".split()
ACCELERATION = "qacc actuator_force qfrc_actuator qfrc_smooth qacc_smooth qfrc_constraint act_dot".split()
STATE = "qpos qvel act ctrl qacc_warmstart mocap_pos mocap_quat xfrc_applied qfrc_applied time".split()


def close(actual: torch.Tensor, expected: torch.Tensor, tolerance: float, what: str) -> None:
  torch.testing.assert_close(
    actual.double(), expected.double(), rtol=tolerance, atol=tolerance, msg=lambda text: f"{what}: {text}"
  )


def acceleration_columns(model: mujoco.MjModel) -> torch.Tensor:
  columns = torch.zeros(model.nsensordata, dtype=torch.bool)
  for adr, dim, stage in zip(model.sensor_adr, model.sensor_dim, model.sensor_needstage, strict=True):
    columns[adr : adr + dim] = bool(stage == mujoco.mjtStage.mjSTAGE_ACC)
  return columns


def test_a_step_is_mujocos_with_fresh_positions_and_velocities(sim: Simulation, engine: str) -> None:
  scatter(sim)
  for _ in range(3):  # Contacts and warm starts.
    sim.step()
  before = [reference(sim, world) for world in range(NUM_WORLDS)]
  sim.step()
  tolerance = 1e-9 if engine == "native" else 1e-5
  is_acceleration = acceleration_columns(sim.mj_model)
  for world, (model, data) in enumerate(before):
    mujoco.mj_step(model, data)
    for name in STATE:
      wide = max(tolerance, 5e-4) if name == "qacc_warmstart" else tolerance
      close(getattr(sim.data, name)[world], torch.tensor(getattr(data, name)), wide, name)
    of_the_substep = torch.tensor(data.sensordata)
    for name in ACCELERATION:
      # Forces and accelerations scale with stiff contacts: float32 keeps four digits of them.
      close(getattr(sim.data, name)[world], torch.tensor(getattr(data, name)), max(tolerance, 5e-4), name)
    mujoco.mj_forward(model, data)
    for name in POSITION + VELOCITY:
      field = getattr(sim.data, name)[world]
      close(field, torch.tensor(getattr(data, name)).reshape(field.shape), 10 * tolerance, name)
    sensors, now = sim.data.sensordata[world].double(), torch.tensor(data.sensordata)
    close(sensors[~is_acceleration], now[~is_acceleration], 10 * tolerance, "sensors of positions and velocities")
    close(sensors[is_acceleration], of_the_substep[is_acceleration], max(tolerance, 5e-4), "sensors of accelerations")


@pytest.mark.warp
def test_engines_stay_together_over_many_steps(make_sim: MakeSim) -> None:
  sims = [make_sim(engine) for engine in ("native", "warp")]
  for sim in sims:
    scatter(sim, seed=1)
    for _ in range(50):
      sim.step()
  native, warp = sims
  close(warp.data.qpos, native.data.qpos, 2e-4, "qpos")
  close(warp.data.xpos, native.data.xpos, 2e-4, "xpos")


@pytest.mark.warp
def test_data_fields_have_the_same_names_shapes_and_values_on_both_engines(make_sim: MakeSim) -> None:
  native, warp = make_sim("native"), make_sim("warp")
  for sim in (native, warp):
    scatter(sim)
    sim.step()
    sim.reset(torch.tensor([True, False, False, True]))
  for name in STATE + POSITION + VELOCITY + ACCELERATION + ["sensordata", "eq_active"]:
    expected, actual = getattr(native.data, name), getattr(warp.data, name)
    assert actual.shape == expected.shape, name
    assert actual.shape[0] == NUM_WORLDS
    if name.endswith("mat"):
      assert actual.shape[-2:] == (3, 3)
    close(actual, expected, 5e-4, name)


@pytest.mark.warp
def test_model_fields_have_the_same_names_shapes_and_values_on_both_engines(make_sim: MakeSim) -> None:
  native, warp = make_sim("native"), make_sim("warp")
  for name in sorted(PER_WORLD):
    expected, actual = native.model[name], warp.model[name]
    assert isinstance(expected, TorchArray)
    assert isinstance(actual, TorchArray)
    assert actual.shape == expected.shape, name
    assert actual.shape[0] == 1, name
    close(actual, expected, 1e-6, name)
    for sim in (native, warp):
      default = sim.default_field(name)
      assert default.shape == sim.model[name].shape, name
      assert default.dtype == sim.model[name].dtype, name
      close(default, native.model[name], 1e-6, name)


def test_a_masked_reset_restores_the_models_state_and_touches_no_other_world(make_sim: MakeSim, engine: str) -> None:
  sim, fresh = make_sim(engine), make_sim(engine)
  scatter(sim)
  for _ in range(2):
    sim.step()
  names = STATE + POSITION + VELOCITY + ACCELERATION + ["sensordata"]
  before = {name: getattr(sim.data, name).clone() for name in names}
  mask = torch.tensor([True, False, True, False])
  sim.reset(mask)
  is_acceleration = acceleration_columns(sim.mj_model)
  for name in names:
    after = getattr(sim.data, name)
    assert torch.equal(after[~mask], before[name][~mask]), name
    if name in STATE + POSITION + VELOCITY:
      assert torch.equal(after[mask], getattr(fresh.data, name)[mask]), name
    elif name == "sensordata":
      assert torch.equal(after[mask][:, ~is_acceleration], fresh.data.sensordata[mask][:, ~is_acceleration])
      assert not after[mask][:, is_acceleration].any()
    else:
      assert not after[mask].any(), name


CHANGED = """body_mass body_inertia body_ipos geom_friction actuator_gainprm actuator_biasprm opt.gravity dof_armature
qpos0 jnt_range""".split()


def change(field: Callable[[str], Any], world: int) -> None:
  """Write other masses, centres of mass, frictions, gains, gravity and armature into the fields of a world."""
  field("body_mass")[3] *= 1.0 + 0.2 * world
  field("body_inertia")[3] *= 1.0 + 0.2 * world
  field("body_ipos")[3, 0] += 0.02 * world
  field("geom_friction")[1:4, 0] *= 1.0 - 0.2 * world
  field("actuator_gainprm")[0, 0] += 5.0 * world
  field("actuator_biasprm")[0, 1] -= 5.0 * world
  field("opt.gravity")[0] += 0.5 * world
  field("dof_armature")[18:20] += 0.01 * world
  field("qpos0")[21] += 0.1 * world
  field("jnt_range")[4, 1] += 0.1 * world


def expand_and_change(sim: Simulation) -> None:
  sim.expand_model_fields(CHANGED)
  for world in range(sim.num_envs):
    change(lambda name, world=world: sim.model[name][world], world)
  sim.recompute_constants()


def changed_model(sim: Simulation, world: int) -> mujoco.MjModel:
  """Return the same change in MuJoCo C, with constants that MuJoCo derives."""
  model = copy.copy(sim.mj_model)
  change(lambda name: operator.attrgetter(name)(model), world)
  mujoco.mj_setConst(model, mujoco.MjData(model))
  return model


def test_model_fields_of_each_world_act_as_in_a_separate_model(sim: Simulation, engine: str) -> None:
  expand_and_change(sim)
  sim.reset()
  scatter(sim, seed=2)
  for _ in range(2):
    sim.step()
  tolerance = 1e-9 if engine == "native" else 2e-5
  starts = [reference(sim, world)[1] for world in range(NUM_WORLDS)]
  sim.step()
  derived = "body_subtreemass body_invweight0 dof_invweight0 tendon_invweight0 tendon_length0 actuator_acc0".split()
  for world, data in enumerate(starts):
    model = changed_model(sim, world)
    for name in derived:
      expected = torch.tensor(getattr(model, name))
      field = sim.model[name]
      assert sim.is_expanded(name), name
      close(
        field[world], expected.reshape(field[world].shape), max(tolerance, 2e-4 * float(expected.abs().max())), name
      )
    mujoco.mj_step(model, data)
    close(sim.data.qpos[world], torch.tensor(data.qpos), tolerance, "qpos")
    close(sim.data.qvel[world], torch.tensor(data.qvel), 5 * tolerance, "qvel")
  sim.reset(torch.tensor([False, True, False, True]))
  assert sim.data.qpos[1, 21].item() == pytest.approx(0.1)
  assert sim.data.qpos[3, 21].item() == pytest.approx(0.3)


def test_constants_that_follow_from_poses_of_bodies_are_derived_per_world(sim: Simulation) -> None:
  sim.expand_model_fields(["body_pos", "cam_pos"])
  worlds = torch.arange(NUM_WORLDS, dtype=sim.dtype)
  pendulum, upper = (sim.mj_model.body(name).id for name in ("pendulum", "upper"))
  sim.model.body_pos[:, pendulum, 0] += 0.1 * worlds
  sim.model.body_pos[:, upper, 2] += 0.2 * worlds
  sim.model.cam_pos[:, 0, 1] -= 0.3 * worlds
  sim.recompute_constants()
  sim.reset()
  for world in range(NUM_WORLDS):
    model = copy.copy(sim.mj_model)
    model.body_pos[pendulum, 0] += 0.1 * world
    model.body_pos[upper, 2] += 0.2 * world
    model.cam_pos[0, 1] -= 0.3 * world
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    mujoco.mj_forward(model, data)
    for name in ("eq_data", "cam_pos0", "cam_poscom0", "cam_mat0", "light_pos0", "light_poscom0", "light_dir0"):
      assert sim.is_expanded(name), name
      field = sim.model[name][world]
      close(field, torch.tensor(getattr(model, name)).reshape(field.shape), 1e-6, name)
    for name in ("xpos", "geom_xpos", "cam_xpos", "subtree_com"):
      close(getattr(sim.data, name)[world], torch.tensor(getattr(data, name)), 1e-6, name)


def test_the_compiled_model_is_never_written_to(make_sim: MakeSim, engine: str) -> None:
  def content() -> bytes:
    buffer = np.empty(mujoco.mj_sizeModel(sim.mj_model), dtype=np.uint8)
    mujoco.mj_saveModel(sim.mj_model, None, buffer)
    return buffer.tobytes()

  sim = make_sim(engine)
  before = content()
  default = sim.default_field("geom_friction").clone()
  sim.model.geom_friction[0, 1] = 5.0
  expand_and_change(sim)
  sim.step()
  sim.reset()
  assert content() == before
  assert torch.equal(sim.default_field("geom_friction"), default)


def test_worlds_outside_of_the_mask_keep_every_bit_of_the_model(sim: Simulation) -> None:
  sim.expand_model_fields(["body_mass", "body_ipos", "geom_size", "cam_pos"])
  sim.model.body_ipos[:, 4, 0] += torch.tensor([0.01, 0.02, 0.03, 0.04], dtype=sim.dtype)
  sim.model.body_mass[:, 3] = torch.tensor([3.0, 5.0, 4.0, 6.0], dtype=sim.dtype)
  before = {name: sim.model[name].clone() for name in sorted(PER_WORLD)}
  mask = torch.tensor([False, True, False, True])
  sim.recompute_constants(mask)
  assert sim.model.body_subtreemass[mask, 3].tolist() == [5.0, 6.0]
  changed = {name for name, value in before.items() if not torch.equal(sim.model[name], value)}
  assert {"body_invweight0", "dof_invweight0"} <= changed <= set(sim.expanded_fields)
  for name in changed:
    assert torch.equal(sim.model[name][~mask], before[name][~mask]), name


def test_defaults_can_be_those_of_each_world(sim: Simulation) -> None:
  sim.expand_model_fields(["body_mass"])
  sim.model.body_mass[:, 3] = torch.tensor([1.0, 2.0, 3.0, 4.0], dtype=sim.dtype)
  sim.rebase_default_fields(["body_mass"])
  default = sim.default_field("body_mass")
  sim.model.body_mass.zero_()
  assert default[:, 3].tolist() == [1.0, 2.0, 3.0, 4.0]
  saved = sim.state_dict()
  sim.model.body_mass[:, 3] = 7.0
  sim.rebase_default_fields(["body_mass"])
  assert default[:, 3].tolist() == [7.0] * 4
  sim.load_state_dict(saved)
  assert default[:, 3].tolist() == [1.0, 2.0, 3.0, 4.0]


def test_a_single_world_recomputes_all_constants(make_sim: MakeSim, engine: str) -> None:
  sim = make_sim(engine, num_envs=1)
  sim.expand_model_fields(["geom_size"])
  sim.model.body_mass[:, 3] = 5.0
  sim.recompute_constants()
  assert sim.model.body_subtreemass[0, 3] == 5.0


def test_geoms_that_never_move_are_where_each_world_puts_them(sim: Simulation) -> None:
  floor, crate = sim.mj_model.geom("floor").id, sim.mj_model.geom("crate").id
  fence = sim.mj_model.body("fence").id
  sim.expand_model_fields(["geom_pos", "body_pos"])
  depth = 0.05 * torch.arange(NUM_WORLDS, dtype=sim.dtype)
  sim.model.geom_pos[:, floor, 2] -= depth
  sim.model.body_pos[:, fence, 0] += depth
  sim.recompute_constants()
  torch.testing.assert_close(sim.data.geom_xpos[:, floor, 2], -depth)
  torch.testing.assert_close(sim.data.geom_xpos[:, crate, 0], depth - 2.0)
  sim.reset()
  for _ in range(120):
    sim.step()
  # The ball fell onto the floor of the same world.
  torch.testing.assert_close(sim.data.geom_xpos[:, floor, 2], -depth)
  torch.testing.assert_close(sim.data.qpos[:, 2], 0.1 - depth, rtol=0.0, atol=0.005)


def test_recomputing_constants_leaves_state_and_forces_alone(make_sim: MakeSim, engine: str) -> None:
  sim, other = make_sim(engine), make_sim(engine)
  for s in (sim, other):
    s.expand_model_fields(["body_mass"])
    # Constants in single precision differ from those of MuJoCo's compiler in the last bit.
    s.recompute_constants()
    scatter(s)
    for _ in range(3):
      s.step()
  names = STATE + ACCELERATION + POSITION + VELOCITY + ["sensordata"]
  sim.recompute_constants()
  assert_same(sim, other, names)
  for s in (sim, other):
    s.step()
  assert_same(sim, other)


def test_a_write_to_a_shared_model_field_reaches_every_world(sim: Simulation) -> None:
  assert sim.model.actuator_gainprm.shape[0] == 1
  sim.data.ctrl[:, 1] = 0.5
  sim.step()
  force = sim.data.qfrc_actuator[:, 19].clone()
  sim.model.actuator_gainprm[0, 1, 0] *= 2.0
  sim.step()
  torch.testing.assert_close(sim.data.qfrc_actuator[:, 19], 2.0 * force)
  sim.model.body_mass[0, 3] += 1.0
  sim.recompute_constants()
  torch.testing.assert_close(sim.model.body_subtreemass[0, 3], torch.tensor(3.0, dtype=sim.dtype))


def test_expanding_keeps_values(sim: Simulation, engine: str) -> None:
  default = sim.model.body_mass.clone()
  sim.model.body_mass[0, 1] = 3.0
  sim.expand_model_fields(["body_mass"])
  memory = sim.model.body_mass
  sim.expand_model_fields(["body_mass"])
  assert sim.model.body_mass is memory
  assert sim.is_expanded("body_mass")
  assert sim.is_expanded("body_subtreemass")
  assert not sim.is_expanded("geom_friction")
  assert sim.model.body_mass.shape == (NUM_WORLDS, sim.mj_model.nbody)
  assert (sim.model.body_mass[:, 1] == 3.0).all()
  assert torch.equal(sim.default_field("body_mass"), default)
  assert (sim.mj_model.body_mass == np.float64(default.numpy())).all() or engine == "warp"


def test_sensors_of_forces_do_not_remember_the_substep_before(make_sim: MakeSim, engine: str) -> None:
  # MuJoCo Warp adds touch up, and writes the force of a limit only where there is one.
  spec = """
  <mujoco>
    <worldbody>
      <geom type="plane" size="0 0 1"/>
      <body pos="0 0 .098"><freejoint/><geom size=".1" mass="1"/><site name="skin" size=".11"/></body>
      <body pos="1 0 1">
        <joint name="hinge" axis="0 1 0" limited="true" range="-1 1"/><geom size=".1" pos=".2 0 0"/>
      </body>
    </worldbody>
    <sensor><touch site="skin"/><jointlimitfrc joint="hinge"/></sensor>
  </mujoco>
  """
  sim = make_sim(engine, num_envs=1, spec=spec)
  data = mujoco.MjData(sim.mj_model)
  sim.data.qpos[:, 7] = data.qpos[7] = 1.01
  expected = torch.zeros(2)
  for substep in range(20):
    if substep == 15:
      sim.data.qpos[:, 2] = data.qpos[2] = 1.0
      sim.data.qpos[:, 7] = data.qpos[7] = 0.0
      sim.data.qvel[:] = 0.0
      data.qvel[:] = 0.0
    sim.step()
    mujoco.mj_step(sim.mj_model, data)
    expected = torch.tensor(data.sensordata)
    torch.testing.assert_close(sim.data.sensordata[0].double(), expected, rtol=1e-3, atol=1e-3)
    if substep < 5:
      assert (expected > 0).all()
  assert not expected.any()
