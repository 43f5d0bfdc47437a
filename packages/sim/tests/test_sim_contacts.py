"""Contacts of the substep just done, with the forces that the engine solved for."""

import copy
import dataclasses
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import torch
import warp as wp
from mjlab_core import Contacts, MjlabError, host_contacts
from mjlab_sim import Simulation, SimulationCfg
from sim_world import NUM_WORLDS, SIZES, WORLD, MakeSim, reference, scatter

# Masses of what rests on the floor, by geom.
RESTING = {"ball": 1.0, "rod": 0.5, "block": 2.0}


def found(contacts: Contacts[torch.Tensor]) -> dict[str, np.ndarray]:
  """Its fields by name, without the rows that are none, in an order that follows from what they are."""
  rows = contacts.found.numpy()
  fields = {name: field.double().numpy()[rows] for name, field in vars(contacts).items() if name != "found"}
  order = np.lexsort((*np.round(fields["pos"], 5).T, *fields["geom"].T))
  return {name: field[order] for name, field in fields.items()}


def test_contacts_carry_the_weight_of_resting_bodies(sim: Simulation) -> None:
  model = sim.mj_model
  for world in range(NUM_WORLDS):
    assert not sim.contacts(world).found.any()
  for _ in range(300):
    sim.step()
  for world in range(NUM_WORLDS):
    contacts = found(sim.contacts(world))
    for name, mass in RESTING.items():
      rows = (contacts["geom"] == model.geom(name).id).any(axis=1)
      # The floor comes first, so that forces are those on what rests.
      assert (contacts["geom"][rows, 0] == model.geom("floor").id).all()
      np.testing.assert_allclose(contacts["force"][rows].sum(axis=0), [0, 0, 9.81 * mass], rtol=2e-3, atol=2e-2)
      np.testing.assert_allclose(contacts["normal"][rows], np.tile([0.0, 0.0, 1.0], (rows.sum(), 1)), atol=1e-6)
    assert (np.abs(contacts["dist"]) < 2e-3).all()
  weight = torch.tensor(model.body_mass[1:4] * 9.81)
  vertical = sim.data.qfrc_constraint[:, [2, 8, 14]].double()
  torch.testing.assert_close(vertical, weight.expand(NUM_WORLDS, 3), rtol=1e-3, atol=0.0)
  assert sim.data.qvel[:, :18].abs().max() < 1e-3


def test_contacts_are_those_of_the_contact_sensor(sim: Simulation) -> None:
  block, column = sim.mj_model.geom("block").id, int(sim.mj_model.sensor("contact").adr[0])
  sim.contacts(0)
  scatter(sim)
  seen = 0
  for _ in range(40):
    sim.step()
    for world in range(NUM_WORLDS):
      sensed = sim.data.sensordata[world, column : column + 40].double().numpy().reshape(4, 10)
      sensed = sensed[sensed[:, 0] > 0]
      contacts = found(sim.contacts(world))
      rows = (contacts["geom"] == block).any(axis=1)
      assert rows.sum() == len(sensed)
      seen += len(sensed)
      # The floor is geom 2 of the sensor's pair: its normal is turned.
      order = np.lexsort(np.round(sensed[:, 4:7], 5).T)
      np.testing.assert_array_equal(contacts["pos"][rows], sensed[order, 4:7])
      np.testing.assert_array_equal(contacts["normal"][rows], -sensed[order, 7:10])
      along = (contacts["force"] * contacts["normal"]).sum(axis=1)[rows]
      np.testing.assert_allclose(along, sensed[order, 1], rtol=1e-6, atol=1e-6)
  assert seen > 100


def test_contacts_are_those_of_mujoco_c_in_the_state_before_the_step(sim: Simulation, engine: str) -> None:
  sim.expand_model_fields(["geom_friction", "body_mass"])
  sim.model.geom_friction[2] *= 0.3
  sim.model.body_mass[3] *= 1.5
  sim.recompute_constants()
  sim.contacts(0)
  scatter(sim)
  for _ in range(30):
    sim.step()
  befores = [reference(sim, world) for world in range(NUM_WORLDS)]
  sim.step()
  exact, seen = engine == "native", 0
  for world, (shared, data) in enumerate(befores):
    model = copy.copy(shared)
    for name in sim.expanded_fields:
      field = getattr(model, name)
      field[:] = sim.model[name][world].numpy().reshape(field.shape)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    mujoco.mj_forward(model, data)
    contacts = found(sim.contacts(world))
    order = np.lexsort((*np.round(data.contact.pos, 5).T, *data.contact.geom.T))
    assert len(order) == len(contacts["pos"])
    seen += len(order)
    force = np.zeros((len(order), 6))
    for row, number in enumerate(order):
      mujoco.mj_contactForce(model, data, number, force[row])
    frames = data.contact.frame[order].reshape(-1, 3, 3)
    expected = {
      "geom": data.contact.geom[order],
      "dist": data.contact.dist[order],
      "pos": data.contact.pos[order],
      "normal": frames[:, 0],
      "force": np.einsum("nij,ni->nj", frames, force[:, :3]),
    }
    if exact:
      for name, values in expected.items():
        np.testing.assert_array_equal(contacts[name], values, err_msg=name)
      # Their sum in the joints is that of the engine, bit for bit.
      np.testing.assert_array_equal(data.qfrc_constraint, sim.data.qfrc_constraint[world].numpy())
      continue
    np.testing.assert_array_equal(contacts["geom"], expected["geom"])
    for name in ("dist", "pos", "normal"):
      np.testing.assert_allclose(contacts[name], expected[name], atol=1e-5, err_msg=name)
    # How the corners of a box share its weight is not determined to single precision; what they bear together is.
    for geom in np.unique(expected["geom"][:, 1]):
      rows = expected["geom"][:, 1] == geom
      force, other = contacts["force"][rows].sum(axis=0), expected["force"][rows].sum(axis=0)
      assert np.linalg.norm(force - other) < 2e-3 * np.linalg.norm(other)
  assert seen > NUM_WORLDS


@pytest.mark.parametrize("adhesion", [0.0, 0.5])
@pytest.mark.parametrize("condim", [1, 3, 4, 6])
@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
def test_forces_on_the_host_are_those_of_mj_contact_force_bit_for_bit(cone: str, condim: int, adhesion: float) -> None:
  shapes = ("box", "sphere", "ellipsoid", "capsule", "cylinder")
  bodies = "".join(
    f'<body pos="{0.15 * i} 0 {0.1 + 0.02 * i}" euler="{10 * i} 20 5"><freejoint/>'
    f'<geom type="{shape}" size=".1 .08 .07"/></body>'
    for i, shape in enumerate(shapes)
  )
  geom = f'<geom condim="{condim}" adhesion="{adhesion}" friction=".7 .01 .002"/>'
  model = mujoco.MjModel.from_xml_string(
    f'<mujoco><option cone="{cone}"/><default>{geom}</default>'
    f'<worldbody><geom type="plane" size="2 2 .1"/>{bodies}</worldbody></mujoco>'
  )
  data, seen = mujoco.MjData(model), 0
  data.qvel[:] = np.random.default_rng(0).normal(0.0, 1.0, model.nv)
  for _ in range(100):
    mujoco.mj_step(model, data)
    force, frames = np.zeros((data.ncon, 6)), data.contact.frame.reshape(-1, 3, 3)
    for number in range(data.ncon):
      mujoco.mj_contactForce(model, data, number, force[number])
    rows = data.contact.efc_address >= 0
    expected = np.einsum("nij,ni->nj", frames[rows], force[rows, :3])
    np.testing.assert_array_equal(host_contacts(model, data).force, expected)
    seen += len(expected)
  assert seen > 300


def test_looking_at_contacts_changes_no_bit_of_the_worlds(make_sim: MakeSim, engine: str) -> None:
  states = []
  for looks in (False, True):
    sim = make_sim(engine)
    scatter(sim)
    for step in range(12):
      sim.step()
      if looks:
        sim.contacts(step % NUM_WORLDS)
      if step == 6:
        sim.reset(torch.tensor([False, True, False, False]))
    states.append(sim.state_dict()["data"].values())
  assert all(torch.equal(a, b) for a, b in zip(*states, strict=True))


def test_a_world_that_was_reset_has_no_contacts_and_the_others_keep_theirs(sim: Simulation) -> None:
  sim.contacts(0)
  for _ in range(5):
    sim.step()
  before = [found(sim.contacts(world)) for world in range(NUM_WORLDS)]
  sim.reset(torch.tensor([False, True, False, False]))
  # Derived quantities are computed again; contacts belong to the substep just done.
  _ = sim.data.xpos
  for world in range(NUM_WORLDS):
    after = found(sim.contacts(world))
    if world == 1:
      assert not len(after["pos"])
    else:
      assert len(after["pos"])
      np.testing.assert_array_equal(after["force"], before[world]["force"])
  sim.step()
  assert len(found(sim.contacts(1))["pos"])


def test_contacts_of_every_world_are_kept_from_the_first_call_on(make_sim: MakeSim, engine: str) -> None:
  sim = make_sim(engine, num_envs=70)
  sim.contacts(0)
  assert not sim.contacts(69).found.any()
  sim.step()
  forces = [found(sim.contacts(world))["force"] for world in (69, 1, 0)]
  assert len(forces[0])
  for force in forces[1:]:
    np.testing.assert_allclose(force, forces[0], atol=1e-4)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_contacts_are_kept_in_a_replayed_step_on_a_gpu() -> None:
  sim = Simulation(70, mujoco.MjSpec.from_string(WORLD), SimulationCfg(**SIZES), "cuda")
  graph = sim.capture(sim.step)
  for _ in range(5):
    graph()
  assert not sim.contacts(3).found.any()
  for _ in range(400):
    graph()
  assert graph.num_graphs == 1
  for world in (3, 69):
    contacts = sim.contacts(world)
    weight = contacts.force[contacts.found].sum(dim=0)
    torch.testing.assert_close(
      weight.cpu(), torch.tensor([0.0, 0.0, 9.81 * sum(RESTING.values())]), rtol=5e-3, atol=0.05
    )
  sim.close()


def test_a_world_that_does_not_exist_is_refused(make_sim: MakeSim) -> None:
  sim = make_sim()
  for world in (-1, NUM_WORLDS):
    with pytest.raises(MjlabError, match=rf"world must be in \[0, 3\], got {world}"):
      sim.contacts(world)


# All pairs are those of MuJoCo Warp's convex collision, which finds other contacts than MuJoCo C.
CONVEX = """
<mujoco>
  <default><geom contype="{collides}" conaffinity="{collides}"/></default>
  <option timestep=".005" cone="{cone}" iterations="50" ls_iterations="50"/>
  <worldbody>
    <geom type="box" size="2 2 .1" pos="0 0 -.1"/>
    <body pos="0 0 .0795" euler="90 0 0"><freejoint/><geom type="cylinder" size=".08 .1"/></body>
    <body pos=".5 0 .0495"><freejoint/><geom type="ellipsoid" size=".1 .07 .05"/></body>
    <body pos="1 0 .0995"><freejoint/><geom type="cylinder" size=".08 .1"/></body>
    <body pos="1 0 .2485"><freejoint/><geom type="ellipsoid" size=".1 .07 .05"/></body>
  </worldbody>
</mujoco>
"""


@pytest.mark.warp
@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
def test_forces_of_mujoco_warp_are_those_of_mujoco_c_where_the_contacts_are(make_sim: MakeSim, cone: str) -> None:
  # MuJoCo Warp is given the contacts: of geoms that collide it would only compile the kernels.
  sim = make_sim("warp", 1, CONVEX.format(cone=cone, collides=0), integrator="implicitfast", capture=False)
  engine: Any = sim._engine
  engine._m.opt.run_collision_detection = False
  sim.contacts(0)
  model = mujoco.MjModel.from_xml_string(CONVEX.format(cone=cone, collides=1))
  model.opt.integrator = sim.mj_model.opt.integrator
  data, seen = mujoco.MjData(model), 0
  data.qvel[:] = np.random.default_rng(0).normal(0.0, 0.2, model.nv)
  for _ in range(60):
    mujoco.mj_forward(model, data)
    given = mjw.put_data(model, data, nconmax=SIZES["nconmax"], njmax=SIZES["njmax"])
    for name in ("qpos", "qvel", "qacc_warmstart"):
      getattr(sim.data, name).copy_(torch.as_tensor(getattr(data, name)))
    for field in dataclasses.fields(given.contact):
      array = getattr(given.contact, field.name)
      if array.size:
        wp.copy(getattr(engine._d.contact, field.name), array)
    wp.copy(engine._d.nacon, given.nacon)
    sim.step()
    expected, contacts = host_contacts(model, data), found(sim.contacts(0))
    assert len(contacts["pos"]) == len(expected.pos)
    order = np.lexsort((*np.round(expected.pos, 5).T, *expected.geom.T))
    np.testing.assert_allclose(contacts["pos"], expected.pos[order], atol=1e-6)
    for geom in np.unique(expected.geom[:, 1]):
      net, other = (
        force[geoms[:, 1] == geom].sum(axis=0)
        for force, geoms in ((contacts["force"], contacts["geom"]), (expected.force, expected.geom))
      )
      assert np.linalg.norm(net - other) < 1e-3 * max(np.linalg.norm(other), 1.0)
      seen += 1
    mujoco.mj_step(model, data)
  assert seen > 100
