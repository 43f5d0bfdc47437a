"""Contact sensors: what they report, how long, and that nothing leaks."""

from typing import Any, get_args

import mujoco
import numpy as np
import pytest
import torch
from mjlab_sensors import ContactMatch, ContactSensor, ContactSensorCfg
from mjlab_sensors.contact import ContactField
from mjlab_sim import Simulation
from sensor_scenes import ENTITIES, Count, advance, get, simulate, with_robot

TERRAIN = ContactMatch(mode="body", pattern="terrain")
BOX = ContactMatch(mode="body", pattern="box", entity="robot")
WEIGHT = 2.0 * 9.81

ROBOT = """
<mujoco>
  <worldbody>
    <body name="box" pos="0 0 0.1">
      <freejoint/>
      <geom name="box_geom" type="box" size="0.1 0.1 0.1" mass="2"/>
    </body>
    <body name="ball" pos="1 0 0.05">
      <freejoint/>
      <geom name="ball_geom" size="0.05" mass="1"/>
      <geom name="cap" size="0.01" pos="0 0 0.05" mass="0.01"/>
      <body name="tail" pos="-0.04 0 0.1">
        <joint axis="0 1 0" stiffness="50"/>
        <geom name="tail_geom" type="box" size="0.02 0.02 0.02" mass="0.1"/>
        <geom name="tail_tip" type="sphere" size="0.02" pos="-0.06 0 0" mass="0.1"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""

# A ball on a slide: its height is state that a test may write, so it can make and break contact at will.
HOPPER = """
<mujoco>
  <worldbody>
    <body name="foot" pos="0 0 0.1">
      <joint name="z" type="slide" axis="0 0 1"/>
      <geom name="foot_geom" size="0.1" mass="1"/>
    </body>
    <body name="other" pos="1 0 0.1">
      <joint name="other_z" type="slide" axis="0 0 1"/>
      <geom name="other_geom" size="0.1" mass="1"/>
    </body>
  </worldbody>
</mujoco>
"""


def scene(robot: str = ROBOT) -> mujoco.MjSpec:
  return with_robot(robot, '<geom name="ground" type="plane" size="0 0 1"/>')


def build(*cfgs: ContactSensorCfg, robot: str = ROBOT, num_envs: int = 2) -> tuple[Simulation, list[ContactSensor]]:
  return simulate(scene(robot), *cfgs, num_envs=num_envs)


@pytest.mark.parametrize("reduce", ["none", "mindist", "maxforce", "netforce"])
def test_all_fields_equal_those_of_mujoco(reduce: Any) -> None:
  slots = 1 if reduce == "netforce" else 3
  fields: tuple[ContactField, ...] = get_args(ContactField)
  cfg = ContactSensorCfg(
    name="feet",
    primary=ContactMatch(mode="geom", pattern="(box|ball)_geom", entity="robot"),
    fields=fields,
    reduce=reduce,
    num_slots=slots,
  )
  sim, (sensor,) = build(cfg)
  spec = scene()
  for geom in ("robot/box_geom", "robot/ball_geom"):
    oracle = spec.add_sensor(name=geom, type=mujoco.mjtSensor.mjSENS_CONTACT, objname=geom)
    oracle.objtype = mujoco.mjtObj.mjOBJ_GEOM
    oracle.intprm = [0b1111111, ["none", "mindist", "maxforce", "netforce"].index(reduce), slots]
  model = spec.compile()
  data = mujoco.MjData(model)
  # A spin, so that no two corners press alike and the order of the contacts is no accident.
  spin = [0.5, 0.3, 0.1]
  sim.data.qvel[:, 3:6] = torch.tensor(spin, dtype=sim.dtype)
  data.qvel[3:6] = spin
  touched = set()
  for _ in range(30):
    advance(sim, [sensor])
    mujoco.mj_step(model, data)
    expected = torch.from_numpy(data.sensordata.reshape(2 * slots, -1).copy())
    columns = []
    for field in fields:
      value = get(getattr(sensor.data, field))[0]
      columns.append(value[:, None] if value.ndim == 1 else value)
    torch.testing.assert_close(torch.cat(columns, dim=1), expected, rtol=1e-9, atol=1e-9)
    touched |= set(expected[:, 0].tolist())
  assert {0.0, 1.0} < touched or reduce == "netforce"
  assert max(touched) > 1


def test_other_fields_are_none() -> None:
  _, (sensor,) = build(ContactSensorCfg(name="feet", primary=BOX, fields=("force",)))
  assert [name for name, value in vars(sensor.data).items() if value is not None] == ["force"]


def test_air_time_brings_found_along() -> None:
  sim, (sensor,) = build(ContactSensorCfg(name="feet", primary=BOX, fields=("force",), track_air_time=True))
  advance(sim, [sensor], 3)
  assert (get(sensor.data.found) > 0).all()
  assert (get(sensor.data.current_contact_time) > 0).all()


def test_one_native_sensor_per_primary_and_all_side_by_side() -> None:
  feet = ContactSensorCfg(name="feet", primary=ContactMatch(mode="geom", pattern=".*", entity="robot"))
  same = ContactSensorCfg(name="same", primary=feet.primary, secondary=TERRAIN, track_air_time=True)
  sim, (first, second) = build(feet, same)
  assert sim.mj_model.nsensor == 10
  assert first.primary_names == second.primary_names
  base = sim.data.sensordata.data_ptr()
  for sensor, start in ((first, 0), (second, 20)):
    assert get(sensor.data.found).data_ptr() == base + start * sim.data.sensordata.element_size()


def test_a_subtree_sees_the_contacts_within_itself_and_a_body_only_its_own() -> None:
  crossed_legs = """
  <mujoco>
    <option gravity="0 0 0"/>
    <worldbody>
      <body name="trunk" pos="0 0 0.5">
        <geom name="trunk" size="0.1" mass="1"/>
        <body name="left"><joint name="l" axis="1 0 0"/><geom name="left" size="0.05" pos="0 0.03 -0.45"/></body>
        <body name="right"><joint name="r" axis="1 0 0"/><geom name="right" size="0.05" pos="0 -0.03 -0.45"/></body>
      </body>
    </worldbody>
  </mujoco>
  """
  trunk = ContactMatch(mode="subtree", pattern="trunk", entity="robot")
  sim, sensors = build(
    ContactSensorCfg(name="self", primary=trunk, secondary=trunk),
    ContactSensorCfg(name="ground", primary=trunk, secondary=TERRAIN),
    ContactSensorCfg(name="body", primary=ContactMatch(mode="body", pattern="trunk", entity="robot")),
    ContactSensorCfg(name="legs", primary=ContactMatch(mode="geom", pattern="left|right", entity="robot"), num_slots=2),
    robot=crossed_legs,
  )
  advance(sim, sensors)
  among_itself, ground, body, legs = (get(sensor.data.found)[0].tolist() for sensor in sensors)
  assert among_itself == [1]
  assert ground == [2]
  assert body == [0]
  assert legs == [2, 2, 2, 2]


def test_primaries_come_in_model_order_or_in_that_of_the_patterns() -> None:
  spec = scene()
  pattern = ("ball_geom", "box_geom", "tail_.*")

  def names(**kwargs: Any) -> tuple[str, ...]:
    match = ContactMatch(mode="geom", pattern=pattern, entity="robot", **kwargs)
    return tuple(name.removeprefix("robot/") for name in match.names_in(spec, ENTITIES, match.mode, ""))

  assert names() == ("box_geom", "ball_geom", "tail_geom", "tail_tip")
  assert names(preserve_order=True) == ("ball_geom", "box_geom", "tail_geom", "tail_tip")
  assert names(exclude=("tail_tip", "b.*x_geom")) == ("ball_geom", "tail_geom")


def test_contacts_are_those_of_the_substep_just_done_whatever_the_fields() -> None:
  cfgs = [
    ContactSensorCfg(name="found", primary=BOX, fields=("found",), reduce="none"),
    ContactSensorCfg(name="deepest", primary=BOX, fields=("found", "dist"), reduce="mindist"),
    ContactSensorCfg(name="force", primary=BOX),
  ]
  sim, sensors = build(*cfgs)
  advance(sim, sensors, 3)
  sim.data.qpos[:, 2] += 1.0
  for sensor in sensors:
    assert (get(sensor.data.found) == 4).all(), "the box was lifted, but no substep has been done since"
  advance(sim, sensors)
  for sensor in sensors:
    assert (get(sensor.data.found) == 0).all()


def test_contacts_are_zero_in_worlds_just_reset_until_the_next_substep() -> None:
  sim, sensors = build(
    ContactSensorCfg(name="feet", primary=BOX, history_length=2),
    ContactSensorCfg(name="only", primary=BOX, fields=("found", "dist"), reduce="none"),
    num_envs=3,
  )
  advance(sim, sensors, 3)
  before = [[value.clone() for value in vars(sensor.data).values() if value is not None] for sensor in sensors]
  mask = torch.tensor([False, True, False])
  sim.reset(mask)
  for sensor in sensors:
    sensor.reset(mask)
  for sensor, old in zip(sensors, before, strict=True):
    new = [value for value in vars(sensor.data).values() if value is not None]
    for value, was in zip(new, old, strict=True):
      assert (value[1] == 0).all()
      assert torch.equal(value[~mask], was[~mask])
  advance(sim, sensors)
  assert (get(sensors[0].data.found) == 4).all()
  assert (get(sensors[1].data.found) == 4).all()


class Stopwatch:
  """Air and contact times of one foot, spelled out."""

  def __init__(self) -> None:
    self.phase: str | None = None
    self.landed = self.lifted = False
    self.current = {"air": 0.0, "contact": 0.0}
    self.last = {"air": 0.0, "contact": 0.0}

  def update(self, touching: bool, dt: float) -> None:
    phase, other = ("contact", "air") if touching else ("air", "contact")
    if self.phase == other:
      self.last[other] = self.current[other] + dt
      self.landed, self.lifted = touching, not touching
    self.phase = phase
    self.current[other] = 0.0
    self.current[phase] += dt

  def just(self, phase: str, dt: float) -> bool:
    switched = self.landed if phase == "contact" else self.lifted
    return self.phase == phase and switched and self.current[phase] < dt + 1e-6


def test_times_follow_the_contacts_through_random_hops_and_partial_resets() -> None:
  feet = ContactMatch(mode="body", pattern=".*", entity="robot")
  cfg = ContactSensorCfg(name="feet", primary=feet, secondary=TERRAIN, track_air_time=True, num_slots=2)
  num_envs, rng = 4, np.random.default_rng(0)
  sim, (sensor,) = build(cfg, robot=HOPPER, num_envs=num_envs)
  watches = [[Stopwatch() for _ in range(2)] for _ in range(num_envs)]
  dt, touching = sim.timestep, np.zeros((num_envs, 2), dtype=bool)
  seen = {"contact": 0, "air": 0}
  for substep in range(200):
    if substep % 4 == 0:
      mask = rng.random(num_envs) < 0.1
      sim.reset(torch.from_numpy(mask))
      sensor.reset(torch.from_numpy(mask))
      for world in np.flatnonzero(mask):
        watches[world] = [Stopwatch() for _ in range(2)]
    touching ^= rng.random((num_envs, 2)) < 0.2
    sim.data.qpos[:] = torch.from_numpy(np.where(touching, -0.001, 0.05))
    sim.data.qvel.zero_()
    advance(sim, [sensor])
    data = sensor.data
    for world in range(num_envs):
      for foot in range(2):
        watches[world][foot].update(bool(touching[world, foot]), dt)
    for field, attribute, phase in (
      ("current_air_time", "current", "air"),
      ("current_contact_time", "current", "contact"),
      ("last_air_time", "last", "air"),
      ("last_contact_time", "last", "contact"),
    ):
      expected = [[getattr(watch, attribute)[phase] for watch in row] for row in watches]
      torch.testing.assert_close(getattr(data, field), torch.tensor(expected, dtype=sim.dtype), msg=field)
    for phase, compute in (("contact", sensor.compute_first_contact), ("air", sensor.compute_first_air)):
      expected = [[watch.just(phase, 4 * dt) for watch in row] for row in watches]
      assert compute(4 * dt).tolist() == expected
      seen[phase] += np.sum(expected)
  assert min(seen.values()) > 50


def test_pairs_are_reported_separately_and_air_ends_with_any_of_them() -> None:
  # Two feet above two plates each; which plate a foot touches is written as state.
  plates = "".join(
    f'<geom name="plate{i}{side}" type="box" size="0.2 0.2 0.1" pos="{x} {y} -0.1"/>'
    for side, y in (("a", 0.2), ("b", -0.2))
    for i, x in enumerate((0.0, 1.0))
  )
  robot = HOPPER.replace('axis="0 0 1"/>', 'axis="0 0 1"/><joint type="slide" axis="0 1 0"/>').replace(
    "<worldbody>", f'<option gravity="0 0 0"/><worldbody><body name="plates" pos="0 0 -0.5">{plates}</body>'
  )
  foot = ContactMatch(mode="body", pattern=("foot", "other"), entity="robot")
  cfg = ContactSensorCfg(
    name="feet",
    primary=foot,
    secondary=ContactMatch(mode="geom", pattern="plate.*", entity="robot"),
    num_slots=2,
    track_air_time=True,
  )
  sim, (sensor,) = build(cfg, robot=robot)
  assert sensor.contact_shape == (2, 4, 2)
  assert sensor.secondary_names == tuple(f"robot/plate{i}{side}" for side in "ab" for i in (0, 1))
  for height, side, expected in (
    (0.0, 0.0, []),
    (-0.501, 0.2, [(0, 0), (1, 1)]),
    (-0.501, -0.2, [(0, 2), (1, 3)]),
    (-0.501, 0.0, [(0, 0), (0, 2), (1, 1), (1, 3)]),
    (0.0, 0.0, []),
  ):
    for _ in range(2):
      sim.data.qpos[:] = torch.tensor([height, side] * 2, dtype=sim.dtype)
      sim.data.qvel.zero_()
      advance(sim, [sensor])
    found = get(sensor.data.found)[0].unflatten(0, sensor.contact_shape)
    assert found[..., 0].nonzero().tolist() == [list(pair) for pair in expected]
    in_contact = get(sensor.data.current_contact_time)[0] > 0
    assert in_contact.tolist() == [bool(expected)] * 2
  # One phase of contact of six substeps, whichever plate it was.
  torch.testing.assert_close(get(sensor.data.last_contact_time)[0], torch.full((2,), 7 * sim.timestep, dtype=sim.dtype))


def test_contacts_with_anything_but_oneself() -> None:
  # The tail leans on the ball that carries it, and the box on the ground.
  others = ContactMatch(mode="body", pattern=".*", exclude="robot/(ball|tail)")
  ball = ContactMatch(mode="subtree", pattern="ball", entity="robot")
  spec = scene()
  sensor = ContactSensorCfg(name="ball", primary=ball, secondary=others).build()
  assert isinstance(sensor, ContactSensor)
  sensor.edit_spec(spec, ENTITIES)
  assert sensor.secondary_names == ("world", "terrain", "robot/box")


def test_the_force_history_follows_the_decimation() -> None:
  cfg = ContactSensorCfg(name="feet", primary=BOX, history_length="decimation")
  for decimation in (2, 5):
    spec, sensor = scene(), cfg.build()
    sensor.decimation = decimation
    sensor.edit_spec(spec, ENTITIES)
    sensor.initialize(Simulation(2, spec), ENTITIES)
    assert get(sensor.data.force_history).shape == (2, 1, decimation, 3)
  with pytest.raises(ValueError, match=r"'feet': history_length='decimation' needs an environment"):
    cfg.build().edit_spec(scene(), ENTITIES)


def test_force_history_is_the_newest_first_and_empties_at_a_reset() -> None:
  sim, (sensor,) = build(ContactSensorCfg(name="feet", primary=BOX, num_slots=4, history_length=3))
  mask = torch.tensor([True, False])
  past = [torch.zeros(2, 4, 3, dtype=sim.dtype)] * 3
  for substep in range(12):
    if substep == 6:
      sensor.reset(mask)
      past = [torch.where(mask[:, None, None], 0.0, force) for force in past]
      assert torch.equal(get(sensor.data.force_history), torch.stack(past, dim=2))
    advance(sim, [sensor])
    past = [get(sensor.data.force).clone(), *past[:2]]
    assert torch.equal(get(sensor.data.force_history), torch.stack(past, dim=2))
  assert past[0].abs().max() > 1.0


def test_a_substep_costs_at_most_ten_operations_and_a_reading_none(count_operations: Count) -> None:
  cfg = ContactSensorCfg(
    name="feet", primary=ContactMatch(mode="geom", pattern=".*", entity="robot"), track_air_time=True, history_length=4
  )
  idle = ContactSensorCfg(name="idle", primary=BOX)
  sim, (sensor, plain) = build(cfg, idle)
  sim.step()
  for work, limit in (
    (lambda: sensor.update(sim.timestep), 10),
    (lambda: plain.update(sim.timestep), 0),
    (lambda: sensor.data, 0),
    (lambda: sensor.reset(torch.tensor([True, False])), 2),
  ):
    assert count_operations(work) <= limit


def test_update_and_reset_work_in_memory_that_stays() -> None:
  cfg = ContactSensorCfg(name="feet", primary=BOX, track_air_time=True, history_length=4)
  sim, (sensor,) = build(cfg)
  advance(sim, [sensor])
  addresses = [value.data_ptr() for value in vars(sensor.data).values() if value is not None]
  advance(sim, [sensor], 3)
  sim.reset(torch.tensor([True, False]))
  sensor.reset(torch.tensor([True, False]))
  assert [value.data_ptr() for value in vars(sensor.data).values() if value is not None] == addresses


def test_first_contact_needs_air_time() -> None:
  _, (sensor,) = build(ContactSensorCfg(name="feet", primary=BOX))
  with pytest.raises(ValueError, match="track_air_time=True"):
    sensor.compute_first_contact(0.02)
