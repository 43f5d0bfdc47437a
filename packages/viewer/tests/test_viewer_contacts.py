"""Drawings of contacts, against those of MuJoCo."""

import mujoco
import numpy as np
import pytest
import torch
from mjlab_core import Contacts, host_contacts
from mjlab_viewer import BrowserViewer, OffscreenRenderer, PictureCfg, SnapshotTaker
from mjlab_viewer.drawing.contacts import contact_shapes
from viewer_env import BoxEnv
from viewer_page import inputs_of

# A stack, and a tilted wall with a ball on it. The geom of the wall comes after that of the ball.
STACK = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="2 2 1"/>
    <body pos="0 0 .0995"><freejoint/><geom type="box" size=".1 .1 .1" mass="1"/></body>
    <body pos="0 0 .299"><freejoint/><geom type="box" size=".1 .1 .1" mass="2"/></body>
    <body pos="1 0 .0995"><freejoint/><geom name="ball" size=".1" mass=".5"/></body>
    <body name="wall" pos="1.15 0 .1" euler="0 -30 0"><geom name="wall" type="box" size=".05 .3 .1"/></body>
  </worldbody>
</mujoco>
"""
WORLDS = 3


def settled(xml: str) -> tuple[mujoco.MjModel, mujoco.MjData]:
  model = mujoco.MjModel.from_xml_string(xml)
  data = mujoco.MjData(model)
  for _ in range(100):
    mujoco.mj_step(model, data)
  mujoco.mj_forward(model, data)
  return model, data


@pytest.mark.parametrize("split", [False, True])
def test_discs_and_arrows_are_those_that_mujoco_draws(split: bool) -> None:
  model, data = settled(STACK)
  option, scene = mujoco.MjvOption(), mujoco.MjvScene(model, maxgeom=200)
  for flag in (mujoco.mjtVisFlag.mjVIS_CONTACTPOINT, mujoco.mjtVisFlag.mjVIS_CONTACTFORCE):
    option.flags[flag] = 1
  option.flags[mujoco.mjtVisFlag.mjVIS_CONTACTSPLIT] = split
  decor = mujoco.mjtCatBit.mjCAT_DECOR.value
  mujoco.mjv_updateScene(model, data, option, None, mujoco.MjvCamera(), decor, scene)
  geoms = list(scene.geoms[: scene.ngeom])
  theirs = [geom for geom in geoms if geom.type == mujoco.mjtGeom.mjGEOM_CYLINDER]
  points, *forces = contact_shapes(host_contacts(model, data), model, points=True, forces=True, split=split)
  assert len(points) == len(theirs) == data.ncon > 9
  turned = np.zeros(9)
  for row, geom in enumerate(theirs):
    np.testing.assert_allclose(points.position[row], geom.pos, atol=1e-6)
    np.testing.assert_allclose(points.size[row], geom.size, rtol=1e-6)
    np.testing.assert_allclose(points.color[row], geom.rgba)
    mujoco.mju_quat2Mat(turned, points.direction[row])
    np.testing.assert_allclose(turned.reshape(3, 3)[:, 2], geom.mat[:, 2], atol=1e-6)
  arrows = [geom for geom in geoms if geom not in theirs]
  assert [len(part) for part in forces] == [data.ncon] * (1 + split)
  assert len(arrows) == data.ncon * (1 + split)
  for number, geom in enumerate(arrows):
    row, part = divmod(number, 1 + split)
    shown = forces[part]
    np.testing.assert_allclose(shown.position[row], geom.pos, atol=1e-6)
    np.testing.assert_allclose(shown.color[row], geom.rgba)
    length = np.linalg.norm(shown.direction[row])
    assert length == pytest.approx(geom.size[2], rel=1e-5, abs=1e-9)
    assert shown.size[row, 0] == pytest.approx(geom.size[0])
    # MuJoCo draws a head at either end where both are bodies: along the line it is the same.
    assert abs(shown.direction[row] @ geom.mat[:, 2]) == pytest.approx(length, rel=1e-5, abs=1e-9)


def test_an_arrow_is_the_force_on_the_body_that_can_move() -> None:
  model, data = settled(STACK)
  contacts = host_contacts(model, data)
  (forces,) = contact_shapes(contacts, model, points=False, forces=True)
  wall = contacts.geom[:, 1] == model.geom("wall").id
  assert wall.sum() == 1
  (push,) = forces.direction[wall]
  # Away from the wall.
  assert push[0] < 0
  # Floor and boxes carry what is above them.
  assert (forces.direction[~wall, 2] > 0).all()


def known(count: int, world: int, found: int | None = None) -> Contacts[torch.Tensor]:
  """Return contacts in a row that do not follow from the state; only the first `found` rows are contacts."""
  rows = torch.arange(count)
  return Contacts(
    found=rows < (count if found is None else found),
    geom=torch.tensor([[0, 1]]).repeat(count, 1),
    dist=torch.zeros(count),
    pos=torch.stack([rows + 10.0 * world, rows * 0.0, rows * 0.0 + 2.0], dim=1),
    normal=torch.tensor([[0.0, 0.0, 1.0]]).repeat(count, 1),
    force=torch.tensor([[0.0, 0.0, 7.0]]).repeat(count, 1),
  )


@pytest.fixture
def env() -> BoxEnv:
  env = BoxEnv(WORLDS)
  env.sim.known_contacts = {world: known(2 + world, world) for world in range(WORLDS)}
  return env


def test_a_snapshot_has_the_contacts_of_the_selected_world_or_of_each(env: BoxEnv) -> None:
  taker = SnapshotTaker(env, contacts=True)
  assert [len(contacts.pos) for contacts in taker.take((2, 0)).contacts] == [4]
  assert [len(contacts.pos) for contacts in taker.take((2, 0), apart=True).contacts] == [4, 2]
  np.testing.assert_allclose(taker.take((1,)).contacts[0].pos[:, 0], [10.0, 11.0, 12.0])
  assert SnapshotTaker(env).take((2, 0)).contacts == []


def test_empty_rows_and_rows_that_are_not_finite_are_left_out(env: BoxEnv) -> None:
  env.sim.known_contacts[0] = known(6, 0, found=3)
  env.sim.known_contacts[0].force[1] = torch.nan
  (contacts,) = SnapshotTaker(env, contacts=True).take((0,)).contacts
  np.testing.assert_allclose(contacts.pos[:, 0], [0.0, 2.0])


@pytest.mark.parametrize("are_known", [True, False])
def test_pictures_show_contacts_of_the_simulation_or_else_of_mujoco(opengl: None, env: BoxEnv, are_known: bool) -> None:
  for _ in range(60):
    env.step(torch.zeros(WORLDS, 1))
  if not are_known:
    env.sim.known_contacts.clear()
  cfg = PictureCfg(width=96, height=72, shadows=False, contacts=True)
  with OffscreenRenderer(env.sim.mj_model, cfg) as renderer:
    for world in range(WORLDS):
      renderer.render(SnapshotTaker(env, contacts=True).take((world,)))
      geoms = renderer._scene.geoms[: renderer._scene.ngeom]
      arrows = [geom.pos for geom in geoms if geom.type == mujoco.mjtGeom.mjGEOM_ARROW]
      expected = env.sim.known_contacts[world].pos.numpy() if are_known else env.sim.datas[world].contact.pos
      np.testing.assert_allclose(arrows, expected, atol=1e-5)


def test_the_page_shows_contacts_of_the_selected_world(env: BoxEnv) -> None:
  with BrowserViewer(env, port=8300) as viewer:
    page, taker = viewer.scene, SnapshotTaker(env, contacts=True)
    for points, forces in ((False, False), (True, False), (True, True)):
      page.scene.show_contact_points, page.scene.show_contact_forces = points, forces
      for world in (2, 0):
        page.show(taker.take((world, 1)))
        expected = env.sim.known_contacts[world].pos.numpy()
        for name, shown in (("ellipsoid", points), ("shaft", forces), ("head", forces)):
          handle = page._shapes._handles.get(name)
          assert (handle is not None and handle.visible) == shown
          if handle is not None and shown and name != "head":
            middle = page.scene.fixed_bodies_frame.position
            np.testing.assert_allclose(handle.batched_positions, expected + middle, atol=1e-5)
        # mjviser draws no contacts.
        assert not any(handle.visible for handle in page.scene._decor_handles.values())
    width = np.asarray(page._shapes._handles["shaft"].batched_scales)[0, 0]
    assert width == pytest.approx(3 * env.sim.mj_model.vis.scale.forcewidth * env.sim.mj_model.stat.meansize)
    inputs_of(viewer)["Split normal/friction"].value = True
    page.show(taker.take((0, 1)))
    assert len(page._shapes._handles["shaft"].batched_positions) == 4


def test_without_known_contacts_the_page_shows_those_of_the_state(env: BoxEnv) -> None:
  env.sim.known_contacts.clear()
  for _ in range(60):
    env.step(torch.zeros(WORLDS, 1))
  with BrowserViewer(env, port=8300) as viewer:
    viewer.scene.scene.show_contact_forces = True
    viewer.scene.show(SnapshotTaker(env, contacts=True).take((1,)))
    shafts = viewer.scene._shapes._handles["shaft"]
    # Relative to the followed robot.
    expected = env.sim.datas[1].contact.pos - env.sim.datas[1].xpos[1]
    np.testing.assert_allclose(shafts.batched_positions, expected, atol=1e-5)
