"""The broad phase of groups finds exactly the pairs of geoms that MuJoCo Warp's own finds."""

from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import pytest
import warp as wp
from mjlab_sim import Simulation, SimulationCfg
from mjlab_sim.warp import internals
from mjlab_sim.warp.collision.grouped_broadphase import GroupedBroadphase, grouped_broadphase

WORLDS = 6
KINDS = ("BOX", "SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER")


def scene(boxes: int = 80, kinds: tuple[str, ...] = KINDS) -> mujoco.MjSpec:
  """Two robots of twelve geoms over ground of many, with margins, gaps, pairs, exclusions and distance sensors."""
  random = np.random.default_rng(0)
  spec = mujoco.MjSpec()
  spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[9, 9, 0.1], pos=[0, 0, -0.5], name="plane")
  mocap = spec.worldbody.add_body(name="moved", mocap=True)
  corner = spec.worldbody.add_body(name="corner", pos=[1, 1, 0], quat=[0.9, 0.1, 0.3, 0.2])
  for i in range(boxes):
    place, turn = random.uniform([-4, -4, -0.2], [4, 4, 0.3]), random.normal(size=4)
    owner = (spec.worldbody, spec.worldbody, mocap, corner)[i % 4]
    kind = getattr(mujoco.mjtGeom, "mjGEOM_" + ("BOX" if i % 2 else kinds[i // 2 % len(kinds)]))
    sizes = random.uniform(0.02, 1.0, 3) ** 2
    owner.add_geom(
      name=f"still{i}", type=kind, size=sizes, pos=place, quat=turn, margin=0.02 * (i % 3), gap=0.01 * (i % 2)
    )
  for robot in range(2):
    body = spec.worldbody.add_body(name=f"robot{robot}", pos=[robot, 0, 0.5])
    body.add_freejoint()
    for i in range(12):
      kind = getattr(mujoco.mjtGeom, "mjGEOM_" + kinds[i % len(kinds)])
      body.add_geom(
        name=f"geom{robot}_{i}", type=kind, size=[0.05, 0.08, 0.06], margin=0.03 * (i % 2), conaffinity=i % 4 != 3
      )
      if i % 2:
        body = body.add_body(name=f"link{robot}_{i}", pos=[0, 0, -0.15])
        body.add_joint(axis=[0, 1, 0])
        body.mass, body.inertia, body.explicitinertial = 1.0, [0.1, 0.1, 0.1], True
  if kinds == KINDS:
    spec.add_hfield(name="ground", nrow=5, ncol=5, size=[1, 1, 0.2, 0.1], userdata=random.random(25))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="ground", pos=[2, 0, 0])
    spec.add_pair(geomname1="geom0_3", geomname2="still7", margin=0.5, gap=0.1)
    spec.add_exclude(bodyname1="robot0", bodyname2="corner")
    spec.add_sensor(
      name="away",
      type=mujoco.mjtSensor.mjSENS_GEOMDIST,
      objtype=mujoco.mjtObj.mjOBJ_GEOM,
      objname="geom1_2",
      reftype=mujoco.mjtObj.mjOBJ_GEOM,
      refname="still9",
      cutoff=9.0,
    )
  return spec


def pairs_found(m: Any, d: Any, find: Any) -> list[tuple[int, ...]]:
  """Return world, geoms and identifiers of the pairs that a broad phase lists, ordered."""
  lists = [wp.zeros(d.naconmax, dtype=kind) for kind in (wp.vec2i, wp.vec2i, int)]
  names = ("collision_pair", "collision_pairid", "collision_worldid")
  d.ncollision.zero_()
  find(m, d, SimpleNamespace(**dict(zip(names, lists, strict=True))))
  count = int(d.ncollision.numpy()[0])
  assert count <= d.naconmax
  columns = [array.numpy()[:count].reshape(count, -1) for array in reversed(lists)]
  return sorted(map(tuple, np.concatenate(columns, 1).tolist()))


def scatter(model: mujoco.MjModel, d: Any, random: np.random.Generator) -> None:
  """Move all geoms of all worlds, robots near each other: poses that no joints allow are good enough here."""
  stays = model.body_dofnum[model.body_weldid[model.geom_bodyid]] == 0
  at = np.where(stays[:, None], random.uniform(-4, 4, (WORLDS, model.ngeom, 3)), 0.0)
  robot = random.uniform(-3, 3, (WORLDS, model.nbody, 3))[:, model.body_rootid[model.geom_bodyid]]
  at += np.where(stays[:, None], 0.0, robot + random.normal(0.0, 0.2, at.shape))
  at[-1] += 5000.0
  turns = np.linalg.qr(random.normal(size=(WORLDS, model.ngeom, 3, 3)))[0]
  d.geom_xpos = wp.array(at, dtype=wp.vec3)
  d.geom_xmat = wp.array(turns, dtype=wp.mat33)


@pytest.mark.warp
@pytest.mark.parametrize("varied", [False, True])
def test_pairs_are_those_of_mujoco_warp(varied: bool) -> None:
  model, random = scene().compile(), np.random.default_rng(1)
  m, d = mjw.put_model(model), mjw.make_data(model, nworld=WORLDS, nconmax=3000, njmax=10)
  if varied:
    # Sizes, margins and gaps that differ between worlds, where the model's are shared.
    rows = random.uniform(0.5, 2.0, (WORLDS, model.ngeom))
    # MuJoCo Warp takes a geom with a radius of zero for a plane.
    rows[0, -3] = 0.0
    m.geom_rbound = wp.array(model.geom_rbound * rows, dtype=float)
    m.geom_aabb = wp.array(model.geom_aabb.reshape(-1, 2, 3) * rows[:, :, None, None], dtype=wp.vec3)
    m.geom_margin = wp.array(rows - 0.6, dtype=float)
    m.geom_gap = wp.array(0.3 * rows[:, ::-1], dtype=float)
  ours = grouped_broadphase(model, m, d)
  assert ours is not None
  found = 0
  for _ in range(20):
    scatter(model, d, random)
    expected = pairs_found(m, d, internals.nxn_broadphase)
    assert pairs_found(m, d, ours.find_pairs) == expected
    found += len(expected)
  possible = 20 * WORLDS * m.nxn_geom_pair_filtered.shape[0]
  assert 0.005 * possible < found < 0.5 * possible


@pytest.mark.warp
def test_a_step_takes_groups_by_itself_and_finds_the_same_contacts(monkeypatch: pytest.MonkeyPatch) -> None:
  calls = []
  original = GroupedBroadphase.find_pairs
  monkeypatch.setattr(GroupedBroadphase, "find_pairs", lambda *args: calls.append(args) or original(*args))

  def contacts(**options: Any) -> np.ndarray:
    sim = Simulation(
      2, scene(kinds=("SPHERE",)), SimulationCfg(engine="warp", nconmax=500, njmax=600, **options), "cpu"
    )
    engine: Any = sim._engine
    found = int(engine._d.nacon.numpy()[0])
    contact = engine._d.contact
    columns = [getattr(contact, name).numpy()[:found].reshape(found, -1) for name in ("worldid", "geom", "dist", "pos")]
    sim.close()
    rows = np.concatenate(columns, 1)
    return rows[np.lexsort(rows.T[::-1])]

  ours = contacts()
  assert calls
  assert len(ours) > 10
  calls.clear()
  np.testing.assert_array_equal(ours, contacts(broadphase="nxn"))
  assert not calls


@pytest.mark.warp
def test_models_that_gain_nothing_and_other_tests_of_pairs_keep_mujoco_warps() -> None:
  def choose(spec: mujoco.MjSpec, **options: Any) -> GroupedBroadphase | None:
    model = spec.compile()
    m = mjw.put_model(model)
    for name, value in options.items():
      setattr(m.opt, name, value)
    return grouped_broadphase(model, m, mjw.make_data(model, nworld=1, nconmax=10, njmax=10))

  assert choose(scene()) is not None
  assert choose(scene(boxes=20)) is None
  assert choose(scene(), broadphase_filter=mjw.BroadphaseFilter.PLANE | mjw.BroadphaseFilter.AABB) is None
  assert choose(scene(), broadphase=mjw.BroadphaseType.SAP_TILE) is None
  assert choose(scene(), enableflags=int(mjw.EnableBit.SLEEP)) is None
  loose = mujoco.MjSpec()
  for i in range(50):
    loose.worldbody.add_geom(size=[0.1, 0, 0], pos=[i, 0, 0])
    body = loose.worldbody.add_body(pos=[i, 0, 1])
    body.add_freejoint()
    body.add_geom(size=[0.1, 0, 0])
  assert choose(loose) is None
  assert choose(mujoco.MjSpec()) is None


@pytest.mark.warp
def test_groups_hold_geoms_of_one_tree_and_rows_hold_all_pairs() -> None:
  model = scene().compile()
  m = mjw.put_model(model)
  pairs: Any = GroupedBroadphase(model, m, mjw.make_data(model, nworld=1, nconmax=10, njmax=10), members=5)._pairs
  first, member = pairs.first.numpy(), pairs.member.numpy()
  groups = [member[a:b] for a, b in pairwise(first)]
  assert [len(group) for group in groups] == [5, 5, 2, 5, 5, 2]
  assert all(len(set(model.body_treeid[model.geom_bodyid[group]])) == 1 for group in groups)
  row, geoms = pairs.row.numpy(), pairs.geoms.numpy()
  assert row[:, 3].sum() == len(geoms)
  assert sorted(map(tuple, geoms.tolist())) == sorted(map(tuple, m.nxn_geom_pair_filtered.numpy().tolist()))
  for fixed, group, start, count in row[row[:, 1] >= 0]:
    for pair in geoms[start : start + count]:
      assert fixed in pair
      assert set(pair) - {fixed} <= set(groups[group])
