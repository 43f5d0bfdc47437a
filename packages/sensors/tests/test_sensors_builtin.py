"""Sensors that MuJoCo computes: equal to MuJoCo's own, fresh, and checked by name."""

from typing import Any

import mujoco
import pytest
import torch
from mjlab_sensors import BuiltinSensor, BuiltinSensorCfg, ObjRef
from mjlab_sim import Simulation, SimulationCfg

ROBOT = """
<mujoco>
  <worldbody>
    <body name="base" pos="0 0 1">
      <freejoint/>
      <geom name="shell" size="0.1 0.2 0.3" type="box" mass="2"/>
      <site name="imu" pos="0.05 0 0.1" euler="0 90 0"/>
      <camera name="eye" pos="0 0 0.2"/>
      <body name="arm" pos="0.1 0 0">
        <joint name="elbow" axis="0 1 0" range="-1 1" limited="true"/>
        <geom name="rod" type="capsule" size="0.02" fromto="0 0 0 0.3 0 0" mass="0.5"/>
        <site name="tip" pos="0.3 0 0"/>
      </body>
    </body>
    <body name="wrist" pos="2 0 1"><joint name="ball" type="ball"/><geom name="hand" size="0.1" pos="0.1 0 0"/></body>
  </worldbody>
  <tendon><fixed name="cable" limited="true" range="-1 1"><joint joint="elbow" coef="2"/></fixed></tendon>
  <actuator><motor name="motor" joint="elbow"/></actuator>
  <sensor><gyro name="imu_gyro" site="imu"/><framequat name="tilt" objtype="site" objname="imu"/></sensor>
</mujoco>
"""
ENTITIES = {"robot": None}


def ref(type_: Any, name: str) -> ObjRef:
  return ObjRef(type=type_, name=name, entity="robot")


IMU, TIP, ELBOW = ref("site", "imu"), ref("site", "tip"), ref("joint", "elbow")
CABLE, MOTOR, BASE = ref("tendon", "cable"), ref("actuator", "motor"), ref("body", "base")

# Every sensor type with what it is attached to, what it is relative to, and the MJCF that means the same.
OBJECTS: list[tuple[Any, ObjRef | None, ObjRef | None, str]] = [
  *[
    (kind, IMU, None, 'site="robot/imu"')
    for kind in "accelerometer velocimeter gyro force torque touch magnetometer rangefinder".split()
  ],
  *[
    (kind, ELBOW, None, 'joint="robot/elbow"')
    for kind in "jointpos jointvel jointlimitpos jointlimitvel jointlimitfrc jointactuatorfrc".split()
  ],
  *[(kind, ref("joint", "ball"), None, 'joint="robot/ball"') for kind in ("ballquat", "ballangvel")],
  *[
    (kind, CABLE, None, 'tendon="robot/cable"')
    for kind in "tendonpos tendonvel tendonlimitpos tendonlimitvel tendonlimitfrc tendonactuatorfrc".split()
  ],
  *[(kind, MOTOR, None, 'actuator="robot/motor"') for kind in ("actuatorpos", "actuatorvel", "actuatorfrc")],
  *[
    (kind, TIP, ref("xbody", "base"), 'objtype="site" objname="robot/tip" reftype="xbody" refname="robot/base"')
    for kind in "framepos framequat framexaxis frameyaxis framezaxis framelinvel frameangvel".split()
  ],
  *[(kind, BASE, None, 'objtype="body" objname="robot/base"') for kind in ("framelinacc", "frameangacc")],
  (
    "framepos",
    ref("camera", "eye"),
    ref("geom", "rod"),
    'objtype="camera" objname="robot/eye" reftype="geom" refname="robot/rod"',
  ),
  *[(kind, BASE, None, 'body="robot/base"') for kind in ("subtreecom", "subtreelinvel", "subtreeangmom")],
  *[(kind, None, None, "") for kind in ("e_potential", "e_kinetic", "clock")],
]


def scene(elements: str = "") -> mujoco.MjSpec:
  spec = mujoco.MjSpec()
  spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
  spec.attach(
    mujoco.MjSpec.from_string(ROBOT.replace("</sensor>", f"{elements}</sensor>")),
    prefix="robot/",
    frame=spec.worldbody.add_frame(),
  )
  return spec


def build(*cfgs: BuiltinSensorCfg, num_envs: int = 2) -> tuple[Simulation, list[BuiltinSensor]]:
  spec, sensors = scene(), []
  for number, cfg in enumerate(cfgs):
    sensor = cfg.build("" if cfg.name else f"sensor{number}")
    assert isinstance(sensor, BuiltinSensor)
    sensor.edit_spec(spec, ENTITIES)
    sensors.append(sensor)
  sim = Simulation(num_envs, spec, SimulationCfg())
  for sensor in sensors:
    sensor.initialize(sim, ENTITIES)
  return sim, sensors


def test_every_sensor_type_equals_the_same_sensor_in_mjcf() -> None:
  cfgs = [BuiltinSensorCfg(sensor_type=kind, obj=obj, ref=relative) for kind, obj, relative, _ in OBJECTS]
  sim, sensors = build(*cfgs)
  elements = "".join(f'<{kind} name="{i}" {attributes}/>' for i, (kind, *_, attributes) in enumerate(OBJECTS))
  model = scene(elements.replace("robot/", "")).compile()
  model.opt.integrator = sim.mj_model.opt.integrator
  data = mujoco.MjData(model)
  velocity = torch.linspace(-1.0, 1.0, model.nv, dtype=sim.dtype)
  sim.data.qvel[:] = velocity
  sim.data.ctrl[:] = 0.5
  data.qvel[:], data.ctrl[:] = velocity.numpy(), 0.5
  for _ in range(20):
    sim.step()
    mujoco.mj_step(model, data)
  stepped = data.sensordata.copy()
  mujoco.mj_forward(model, data)
  for number, (sensor, (kind, *_)) in enumerate(zip(sensors, OBJECTS, strict=True)):
    element = model.sensor(f"robot/{number}")
    columns = slice(element.adr[0], element.adr[0] + element.dim[0])
    # Accelerations are those of the substep just done; all else is that of the state it led to.
    late = element.needstage[0] == mujoco.mjtStage.mjSTAGE_ACC
    expected = torch.from_numpy((stepped if late else data.sensordata)[columns].copy())
    assert sensor.dim == len(expected)
    torch.testing.assert_close(sensor.data, expected.expand(2, -1), rtol=1e-9, atol=1e-9, msg=kind)


def test_an_existing_element_is_wrapped_by_its_full_name() -> None:
  sim, (named, renamed) = build(
    BuiltinSensorCfg(name="robot/tilt", element="robot/tilt"), BuiltinSensorCfg(name="gyro", element="robot/imu_gyro")
  )
  assert sim.mj_model.nsensor == 2
  sim.data.qvel[:, 3:6] = torch.tensor((1.0, 2.0, 3.0), dtype=sim.dtype)
  # The site's x axis is the body's -z, its z axis the body's x.
  torch.testing.assert_close(renamed.data[0], torch.tensor((-3.0, 2.0, 1.0), dtype=sim.dtype))
  torch.testing.assert_close(named.data[0].norm(), torch.tensor(1.0, dtype=sim.dtype))


def test_a_reading_after_a_write_is_never_stale_and_a_second_one_is_the_same_tensor() -> None:
  sim, (sensor,) = build(BuiltinSensorCfg(sensor_type="framepos", obj=ref("xbody", "base")))
  assert sensor.data[0, 2] == 1.0
  sim.data.qpos[0, 2] = 5.0
  assert sensor.data[:, 2].tolist() == [5.0, 1.0]
  sim.reset(torch.tensor([True, False]))
  assert sensor.data[:, 2].tolist() == [1.0, 1.0]
  assert sensor.data is sensor.data


def test_acceleration_readings_are_of_the_last_substep_and_zero_in_worlds_just_reset() -> None:
  sim, (sensor,) = build(BuiltinSensorCfg(sensor_type="accelerometer", obj=ref("site", "tip")))
  sim.data.qvel[:, 6] = 3.0
  sim.step()
  before = sensor.data.clone()
  assert (before.norm(dim=1) > 0.1).all()
  sim.reset(torch.tensor([True, False]))
  assert (sensor.data[0] == 0).all()
  assert torch.equal(sensor.data[1], before[1])


def test_cutoff_clamps_the_reading() -> None:
  sim, (sensor,) = build(BuiltinSensorCfg(sensor_type="jointvel", obj=ELBOW, cutoff=0.5))
  sim.data.qvel[:, 6] = torch.tensor((-3.0, 0.25), dtype=sim.dtype)
  assert sensor.data[:, 0].tolist() == [-0.5, 0.25]


@pytest.mark.parametrize(
  ("fields", "message"),
  [
    ({}, r"give `element`.* or `sensor_type`"),
    ({"sensor_type": "gyroo", "obj": IMU}, r"sensor type 'gyroo' does not exist. Nearest: gyro"),
    ({"sensor_type": "gyro"}, r"needs a site as `obj`"),
    ({"sensor_type": "gyro", "obj": BASE}, r"takes a site as `obj`, not body 'base'"),
    ({"sensor_type": "gyro", "obj": IMU, "ref": IMU}, r"takes none as `ref`, not site 'imu'"),
    ({"sensor_type": "clock", "obj": IMU}, r"takes none as `obj`"),
    ({"sensor_type": "framepos", "obj": ELBOW}, r"takes a body or xbody or geom or site or camera as `obj`"),
    ({"sensor_type": "gyro", "obj": IMU, "cutoff": -1.0}, r"cutoff must be"),
    ({"element": "robot/imu_gyro", "sensor_type": "gyro"}, r"leave sensor_type"),
  ],
)
def test_a_wrong_configuration_is_refused_by_name(fields: dict[str, Any], message: str) -> None:
  fields = {"name": "probe", **fields}
  with pytest.raises(ValueError, match=rf"BuiltinSensorCfg 'probe': .*{message}"):
    BuiltinSensorCfg(**fields)


@pytest.mark.parametrize(
  ("cfg", "message"),
  [
    (
      BuiltinSensorCfg(element="robot/imu_gyr"),
      r"sensor element 'robot/imu_gyr' does not exist. Nearest: robot/imu_gyro",
    ),
    (BuiltinSensorCfg(sensor_type="gyro", obj=ref("site", "imo")), r"site 'imo' does not exist. Nearest: imu"),
    (
      BuiltinSensorCfg(sensor_type="framepos", obj=IMU, ref=ref("geom", "rad")),
      r"geom 'rad' does not exist. Nearest: rod",
    ),
    (
      BuiltinSensorCfg(sensor_type="gyro", obj=ObjRef(type="site", name="imu", entity="robo")),
      r"entity 'robo' does not exist. Nearest: robot",
    ),
  ],
)
def test_a_name_that_does_not_exist_is_refused_with_the_nearest(cfg: BuiltinSensorCfg, message: str) -> None:
  with pytest.raises(ValueError, match=rf"BuiltinSensorCfg 'probe': {message}"):
    cfg.build("probe").edit_spec(scene(), ENTITIES)


def test_a_new_sensor_does_not_take_the_name_of_an_existing_one() -> None:
  cfg = BuiltinSensorCfg(name="robot/imu_gyro", sensor_type="gyro", obj=IMU)
  with pytest.raises(ValueError, match=r"already has a sensor element .*element='robot/imu_gyro'"):
    cfg.build().edit_spec(scene(), ENTITIES)


def test_an_unknown_type_of_object_is_refused_by_name() -> None:
  with pytest.raises(ValueError, match=r"type of object 'sites' does not exist. Nearest: site"):
    ref("sites", "imu")


def test_nothing_derived_is_saved() -> None:
  _, (sensor,) = build(BuiltinSensorCfg(sensor_type="gyro", obj=IMU))
  _ = sensor.data
  assert sensor.state_dict() == {}
