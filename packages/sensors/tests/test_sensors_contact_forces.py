"""Contact forces in closed form: what rests presses with its weight, what slides rubs, on both engines."""

from typing import Any, get_args

import mujoco
import numpy as np
import pytest
import torch
from mjlab_sensors import ContactMatch, ContactSensor, ContactSensorCfg
from mjlab_sensors.contact import ContactReduce
from sensor_scenes import World

GRAVITY, FRICTION, SETTLE, SLIDE = 9.81, 0.1, 200, 200
MASS = {"lower": 2.0, "middle": 1.0, "upper": 0.5, "slider": 1.5}

# Three boxes on one another, and one that slides along; the joints keep each from turning, so that it is statics.
WORLD = f"""
<mujoco>
  <option gravity="0 0 -{GRAVITY}" cone="elliptic"/>
  <default><geom friction="{FRICTION}" solref="0.02 4" size="0.1 0.1 0.1"/></default>
  <worldbody>
    <geom name="ground" type="plane" size="0 0 1"/>
    <body name="lower" pos="0 0 0.1"><joint axis="0 0 1" type="slide"/><geom type="box" mass="2"/></body>
    <body name="middle" pos="0 0 0.3"><joint axis="0 0 1" type="slide"/><geom type="box" mass="1"/></body>
    <body name="upper" pos="0 0 0.5"><joint axis="0 0 1" type="slide"/><geom type="box" mass="0.5"/></body>
    <body name="slider" pos="1 0 0.1">
      <joint axis="1 0 0" type="slide"/><joint axis="0 0 1" type="slide"/>
      <geom type="box" mass="1.5"/>
    </body>
  </worldbody>
</mujoco>
"""
BOXES = ContactMatch(mode="body", pattern=".*e.*r|middle")
ANYTHING = ContactMatch(mode="body", pattern=("world", "lower", "middle", "upper"), preserve_order=True)


class Boxes(World):
  """The boxes at rest, but for the slider, which was pushed `SLIDE` substeps ago and still slides."""

  def __init__(self, engine: Any) -> None:
    fields: Any = ("found", "force", "torque", "dist", "pos", "normal", "tangent")
    cfgs = [
      ContactSensorCfg(
        name=reduce,
        primary=BOXES,
        secondary=ANYTHING,
        fields=fields,
        reduce=reduce,
        num_slots=1 if reduce == "netforce" else 4,
        history_length=SLIDE,
      )
      for reduce in get_args(ContactReduce)
    ]
    super().__init__(mujoco.MjSpec.from_string(WORLD), *cfgs, engine=engine)
    for _ in range(SETTLE):
      self.sim.step()
    self.sim.data.qvel[:, 3] = 0.6
    self.start = self.sim.data.qvel.clone()
    self.step(SLIDE)
    assert (self.sim.data.qvel[:, 3] > 0.1).all()

  def forces(self, reduce: str) -> tuple[ContactSensor, torch.Tensor]:
    """World-frame force of each pair, (primaries, secondaries, 3) [N], that the primary exerts."""
    sensor: ContactSensor = self.sensors[reduce]
    data: Any = sensor.data
    parts = (data.force, data.normal, data.tangent)
    force, normal, tangent = (value[0].unflatten(0, sensor.contact_shape).double() for value in parts)
    if reduce != "netforce":
      axes = torch.stack((normal, tangent, torch.linalg.cross(normal, tangent)), dim=-1)
      force = (axes * force[..., None, :]).sum(-1)
    return sensor, force.sum(2)


@pytest.fixture(scope="module", params=["native", pytest.param("warp", marks=pytest.mark.warp)])
def boxes(request: pytest.FixtureRequest) -> Boxes:
  return Boxes(request.param)


@pytest.mark.parametrize("reduce", get_args(ContactReduce))
def test_stacked_boxes_press_on_each_other_with_the_weight_above(boxes: Boxes, reduce: str) -> None:
  sensor, force = boxes.forces(reduce)
  assert sensor.primary_names == ("lower", "middle", "upper", "slider")
  assert sensor.secondary_names == ("world", "lower", "middle", "upper")
  weight = torch.tensor([MASS[name] * GRAVITY for name in sensor.primary_names[:3]], dtype=torch.double)
  above = weight.flip(0).cumsum(0).flip(0)
  expected = torch.zeros(3, 4, 3, dtype=torch.double)
  for box in range(3):
    expected[box, box, 2] = -above[box]
    if box < 2:
      expected[box, box + 2, 2] = above[box + 1]
  torch.testing.assert_close(force[:3], expected, rtol=0.01, atol=0.01)
  # All that acts on a box carries its weight.
  torch.testing.assert_close(-force[:3].sum(1)[:, 2], weight, rtol=0.01, atol=0.0)


def test_a_sliding_box_presses_with_its_weight_and_rubs_with_its_friction(boxes: Boxes) -> None:
  net = boxes.sensors["netforce"]
  slider, world = net.primary_names.index("slider"), net.secondary_names.index("world")
  # MuJoCo lets it hop a little, so that it presses with its weight on average.
  history = net.data.force_history.unflatten(1, net.contact_shape)[:, slider, world, 0].double()
  mean = -history.mean(1)
  weight = torch.full((2,), MASS["slider"] * GRAVITY, dtype=torch.double)
  torch.testing.assert_close(mean[:, 2], weight, rtol=0.01, atol=0.0)
  torch.testing.assert_close(mean[:, 0], -FRICTION * mean[:, 2], rtol=0.01, atol=0.0)
  # What it is given changes its momentum, to the last bit.
  change = (boxes.sim.data.qvel - boxes.start)[:, 3:].double() * MASS["slider"]
  given = mean[:, [0, 2]] - torch.stack((torch.zeros(2).double(), weight), dim=1)
  torch.testing.assert_close(given * SLIDE * boxes.sim.timestep, change, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("boxes", ["native"], indirect=True)
def test_forces_are_those_of_mujocos_contacts(boxes: Boxes) -> None:
  model = boxes.sim.mj_model
  data = mujoco.MjData(model)
  for substep in range(SETTLE + SLIDE):
    if substep == SETTLE:
      data.qvel[3] = 0.6
    mujoco.mj_step(model, data)
  expected, bodies = np.zeros((4, 4, 3)), ["lower", "middle", "upper", "slider"]
  for number, contact in enumerate(data.contact):
    wrench = np.zeros(6)
    mujoco.mj_contactForce(model, data, number, wrench)
    force = contact.frame.reshape(3, 3).T @ wrench[:3]
    first, second = (model.body(model.geom_bodyid[geom]).name for geom in contact.geom)
    others = ["world", "lower", "middle", "upper"]
    for here, there, sign in ((first, second, 1.0), (second, first, -1.0)):
      if here in bodies and there in others:
        expected[bodies.index(here), others.index(there)] += sign * force
  for reduce in get_args(ContactReduce):
    np.testing.assert_allclose(boxes.forces(reduce)[1].numpy(), expected, atol=1e-9)
  assert np.abs(expected).max() > 30.0


def test_reductions_pick_the_deepest_and_the_strongest_first(boxes: Boxes) -> None:
  deepest, strongest = (boxes.sensors[reduce] for reduce in ("mindist", "maxforce"))
  distance = deepest.data.dist[0].unflatten(0, deepest.contact_shape)[0, 0]
  assert (distance.diff() >= 0.0).all()
  assert (distance < 0.0).all()
  norm = strongest.data.force[0].norm(dim=-1).unflatten(0, strongest.contact_shape)[0, 0]
  assert (norm.diff() <= 0.0).all()
  assert (norm > 0.0).all()


def test_normals_point_from_primary_to_secondary_and_contacts_lie_between(boxes: Boxes) -> None:
  sensor = boxes.sensors["none"]
  normal, place = (value[0].unflatten(0, sensor.contact_shape) for value in (sensor.data.normal, sensor.data.pos))
  found = sensor.data.found[0].unflatten(0, sensor.contact_shape)
  for primary, secondary, z, up in ((0, 0, 0.0, -1.0), (0, 2, 0.2, 1.0), (1, 1, 0.2, -1.0), (2, 2, 0.4, -1.0)):
    assert (found[primary, secondary] == 4).all()
    torch.testing.assert_close(normal[primary, secondary, :, 2], torch.full((4,), up, dtype=normal.dtype))
    torch.testing.assert_close(
      place[primary, secondary, :, 2], torch.full((4,), z, dtype=place.dtype), atol=4e-3, rtol=0
    )


SLOPE = """
<mujoco>
  <option cone="elliptic"/>
  <worldbody>
    <geom name="slope" type="plane" size="0 0 1" euler="0 20 0"/>
    <body name="box" pos="0 0 0.11" euler="0 20 0"><freejoint/><geom type="box" size="0.1 0.1 0.1" mass="2"/></body>
  </worldbody>
</mujoco>
"""


@pytest.mark.parametrize("engine", ["native", pytest.param("warp", marks=pytest.mark.warp)])
def test_contact_forces_in_the_world_frame_carry_the_weight(engine: str) -> None:
  on: Any = {
    "primary": ContactMatch(mode="body", pattern="box"),
    "secondary": ContactMatch(mode="geom", pattern="slope"),
  }
  cfgs = (
    ContactSensorCfg(name="local", num_slots=4, **on),
    ContactSensorCfg(name="world", num_slots=4, global_frame=True, history_length=2, **on),
    ContactSensorCfg(name="whole", reduce="netforce", **on),
  )
  world = World(mujoco.MjSpec.from_string(SLOPE), *cfgs, engine=engine)
  world.step(300)
  local, data, whole = (world.sensors[cfg.name].data for cfg in cfgs)
  assert data.normal is None
  total = data.force.sum(1).double()
  # The box rests on the slope: its force on the ground is its weight, though normals are tilted.
  torch.testing.assert_close(total, torch.tensor([[0.0, 0.0, -2.0 * GRAVITY]] * 2).double(), atol=0.05, rtol=0.0)
  torch.testing.assert_close(total, whole.force[:, 0].double(), atol=1e-3, rtol=0.0)
  torch.testing.assert_close(local.force.norm(dim=-1), data.force.norm(dim=-1), rtol=1e-4, atol=1e-5)
  torch.testing.assert_close(data.force_history[:, :, 0], data.force)
