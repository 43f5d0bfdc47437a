"""Collisions with height fields on MuJoCo Warp: those of its own kernel to the last bit, and those of MuJoCo C."""

from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from mjlab_sim import Simulation, SimulationCfg
from mjlab_sim.warp import engine as warp_engine
from mjlab_sim.warp.collision import height_fields

WORLDS, POINTS = 32, 41
SHAPES = {
  "sphere": {"type": mujoco.mjtGeom.mjGEOM_SPHERE, "size": [0.08, 0, 0]},
  "capsule": {"type": mujoco.mjtGeom.mjGEOM_CAPSULE, "size": [0.05, 0.2, 0]},
}


def make(margin: float = 0.0, height: float = 0.3, low: float = -0.05) -> Simulation:
  """Two shapes over ground with cells of 10 cm and steps of up to `height`."""
  heights = np.random.default_rng(0).random(POINTS * POINTS)
  spec = mujoco.MjSpec()
  spec.add_hfield(name="ground", nrow=POINTS, ncol=POINTS, size=[2, 2, height, 0.2], userdata=heights)
  spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="ground", margin=margin)
  for name, shape in SHAPES.items():
    body = spec.worldbody.add_body(name=name, pos=[0, 0, 1])
    body.add_freejoint()
    body.add_geom(name=name, contype=0, **shape)
  sim = Simulation(WORLDS, spec, SimulationCfg(engine="warp", nconmax=32, njmax=128))
  random = torch.Generator().manual_seed(1)
  for i in range(len(SHAPES)):
    place = torch.rand(WORLDS, 3, generator=random) * torch.tensor([3.6, 3.6, 0.1 + height])
    place += torch.tensor([-1.8, -1.8, low])
    turn = torch.randn(WORLDS, 4, generator=random)
    sim.data.qpos[:, 7 * i : 7 * i + 7] = torch.cat((place, turn / turn.norm(dim=1, keepdim=True)), 1)
  sim.forward()
  return sim


def contacts(sim: Simulation) -> np.ndarray:
  """All contacts, ordered: world, geoms, number in the pair, distance, place, frame, dimension, friction."""
  engine: Any = sim._engine
  d = engine._d
  found = int(d.nacon.numpy()[0])
  names = ("worldid", "geom", "geomcollisionid", "dist", "pos", "frame", "dim", "friction", "includemargin")
  columns = [getattr(d.contact, name).numpy()[:found].reshape(found, -1) for name in names]
  rows = np.concatenate(columns, 1)
  return rows[np.lexsort(rows[:, :4].T[::-1])]


@pytest.mark.warp
@pytest.mark.parametrize("margin", [0.0, 0.03])
def test_contacts_are_those_of_mujoco_warp_to_the_last_bit(margin: float, monkeypatch: pytest.MonkeyPatch) -> None:
  ours = contacts(make(margin))
  monkeypatch.setattr(warp_engine, "height_field_collisions", lambda m, d: None)
  theirs = contacts(make(margin))
  assert len(ours) > 2 * WORLDS
  np.testing.assert_array_equal(ours, theirs)


@pytest.mark.warp
def test_deepest_contacts_are_those_of_mujoco() -> None:
  sim = make(height=0.02, low=0.03)
  found, model = contacts(sim), sim.mj_model
  data = mujoco.MjData(model)
  compared = 0
  for world in range(WORLDS):
    data.qpos[:] = sim.data.qpos[world].numpy()
    mujoco.mj_forward(model, data)
    for name in SHAPES:
      geom = model.geom(name).id
      theirs = [contact.dist for contact in data.contact if geom in contact.geom]
      ours = found[(found[:, 0] == world) & (found[:, 2] == geom), 4]
      assert (len(theirs) == 0) == (len(ours) == 0), (world, name)
      # Where the middle of a shape is below the ground, the two measure its depth in other directions.
      if len(ours) and min(theirs) > -0.04:
        compared += 1
        assert ours.min() == pytest.approx(min(theirs), abs=1e-4), (world, name)
  assert compared > WORLDS / 4


@pytest.mark.warp
def test_prisms_that_find_no_room_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
  monkeypatch.setattr(height_fields, "_ROOM", 0.25)
  sim = make()
  sim.step()
  (line,) = sim.overflow_report()
  assert "contacts were dropped" in line
  assert "--env.sim.nconmax" in line
