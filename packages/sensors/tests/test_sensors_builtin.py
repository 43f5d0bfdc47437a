"""Sensors that MuJoCo computes: equal to MuJoCo's own, fresh, and checked by name."""

from pathlib import Path
from typing import Any, get_args

import mujoco
import numpy as np
import pytest
import torch
from mjlab_sensors import NATIVE_TYPES, BuiltinSensor, BuiltinSensorCfg, ObjRef
from mjlab_sensors.native.builtin import SensorType
from mjlab_sim import Simulation
from scipy.spatial.transform import Rotation
from sensor_scenes import simulate, with_robot

REFERENCE = Path(__file__).parents[1] / "REFERENCE.md"
ROBOT = """
<mujoco>
  <default><geom contype="0" conaffinity="0"/></default>
  <asset><mesh name="plate" builtin="plate" params="3 3" scale="0.1 0.1 0.005"/></asset>
  <worldbody>
    <camera name="watch" pos="0 -3 1" xyaxes="1 0 0 0 0 1" resolution="4 3"/>
    <site name="zone" type="box" size="0.3 0.3 0.4" pos="0.1 0 1"/>
    <body name="base" pos="0 0 1">
      <freejoint/>
      <geom name="shell" size="0.1 0.2 0.3" type="box" mass="2"/>
      <site name="imu" pos="0.05 0 0.1" euler="0 90 0"/>
      <camera name="eye" pos="0 0 0.2"/>
      <body name="arm" pos="0.1 0 0">
        <joint name="elbow" axis="0 1 0" range="-1 1" limited="true"/>
        <geom name="rod" type="capsule" size="0.02" fromto="0 0 0 0.3 0 0" mass="0.5"/>
        <site name="tip" pos="0.3 0 0"/>
        <body pos="0.3 0 0"><joint name="knuckle" axis="0 1 0"/><geom size="0.02" pos="0.1 0 0" mass="0.1"/></body>
      </body>
    </body>
    <body name="wrist" pos="2 0 1"><joint name="ball" type="ball"/><geom name="hand" size="0.1" pos="0.1 0 0"/></body>
    <body name="pad" pos="3 0 1">
      <geom name="pad" type="box" size="0.1 0.1 0.005" contype="1"/>
      <geom name="skin" type="mesh" mesh="plate" pos="0 0 0.011" mass="0"/>
    </body>
    <body name="finger" pos="3 0 1.053"><freejoint/><geom name="finger" size="0.05" mass="1" conaffinity="1"/>
      <site name="pulp" size="0.06"/></body>
  </worldbody>
  <tendon><fixed name="cable" limited="true" range="-1 1"><joint joint="knuckle" coef="2"/></fixed></tendon>
  <actuator><motor name="motor" joint="elbow"/><motor name="winch" tendon="cable"/></actuator>
  <sensor><gyro name="imu_gyro" site="imu"/><framequat name="tilt" objtype="site" objname="imu"/></sensor>
</mujoco>
"""


def ref(type_: Any, name: str) -> ObjRef:
  return ObjRef(type=type_, name=name, entity="robot")


IMU, TIP, ELBOW = ref("site", "imu"), ref("site", "tip"), ref("joint", "elbow")
CABLE, MOTOR, BASE = ref("tendon", "cable"), ref("actuator", "motor"), ref("body", "base")

# Every sensor type with what it is attached to, what it is relative to, and the MJCF that means the same.
OBJECTS: list[tuple[Any, ObjRef | None, ObjRef | None, str]] = [
  *[
    (kind, IMU, None, 'site="robot/imu"')
    for kind in "accelerometer velocimeter gyro force torque magnetometer rangefinder".split()
  ],
  ("touch", ref("site", "pulp"), None, 'site="robot/pulp"'),
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
  ("camprojection", TIP, ref("camera", "watch"), 'site="robot/tip" camera="robot/watch"'),
  ("insidesite", ref("xbody", "base"), ref("site", "zone"), 'objtype="xbody" objname="robot/base" site="robot/zone"'),
  *[
    (kind, ref("geom", "hand"), ref("body", "pad"), 'geom1="robot/hand" body2="robot/pad"')
    for kind in ("distance", "normal", "fromto")
  ],
  ("tactile", ref("mesh", "plate"), ref("geom", "skin"), 'mesh="robot/plate" geom="robot/skin"'),
]
# Collision sensors see as far as their cutoff.
CUTOFF = dict.fromkeys(("distance", "normal", "fromto"), 5.0)


def scene(elements: str = "") -> mujoco.MjSpec:
  return with_robot(
    ROBOT.replace("</sensor>", f"{elements}</sensor>"), '<geom name="floor" type="plane" size="0 0 1"/>'
  )


def build(*cfgs: BuiltinSensorCfg, elements: str = "", **options: Any) -> tuple[Simulation, list[BuiltinSensor]]:
  return simulate(scene(elements), *cfgs, **options)


def each_type(*, relative: bool = True) -> list[BuiltinSensorCfg]:
  """A sensor of every type; with `relative` False, relative to the world where that is possible."""
  return [
    BuiltinSensorCfg(
      sensor_type=kind,
      obj=obj,
      ref=other if relative or NATIVE_TYPES[kind].needs_reference else None,
      cutoff=CUTOFF.get(kind, 0.0),
    )
    for kind, obj, other, _ in OBJECTS
  ]


@pytest.mark.parametrize("engine", ["native", pytest.param("warp", marks=pytest.mark.warp)])
def test_every_sensor_type_equals_the_same_sensor_in_mjcf(engine: Any) -> None:
  sim, sensors = build(*each_type(), engine=engine)
  elements = "".join(
    f'<{kind} name="{i}" cutoff="{CUTOFF.get(kind, 0)}" {attributes}/>'
    for i, (kind, *_, attributes) in enumerate(OBJECTS)
  )
  model = scene(elements.replace("robot/", "")).compile()
  model.opt.integrator = sim.mj_model.opt.integrator
  data = mujoco.MjData(model)
  velocity = torch.linspace(-1.0, 1.0, model.nv, dtype=sim.dtype)
  velocity[-6:] = 0.0  # The finger stays on its pad.
  sim.data.qvel[:] = velocity
  sim.data.ctrl[:] = 0.5
  # Beyond the limits of joint and tendon.
  sim.data.qpos[:, 7:9] = 1.2
  data.qpos[7:9] = 1.2
  data.qvel[:], data.ctrl[:] = velocity.numpy(), 0.5
  for _ in range(3):
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
    tolerance = 1e-9 if engine == "native" else 2e-3 * max(1.0, float(expected.abs().max()))
    torch.testing.assert_close(sensor.data.double(), expected.expand(2, -1), rtol=0, atol=tolerance, msg=kind)
    assert expected.any(), f"{kind} reads nothing"


def test_the_table_has_every_type_of_mujoco_and_the_reference_shows_it() -> None:
  assert {kind.enum for kind in NATIVE_TYPES.values()} == set(mujoco.mjtSensor.__members__.values())
  assert len(NATIVE_TYPES) == len(mujoco.mjtSensor.__members__)
  declared = set(get_args(SensorType))
  assert declared == {name for name, *_ in OBJECTS}
  assert set(NATIVE_TYPES) - declared == {"contact", "plugin", "user"}
  sim, _ = build(*each_type())
  model, stages = sim.mj_model, ("none", "position", "velocity", "acceleration")
  compiled = {
    model.sensor_type[i]: (model.sensor_dim[i], stages[model.sensor_needstage[i]]) for i in range(model.nsensor)
  }
  rows = ["| type | attached to | relative to | numbers | frame | unit | stage |", "|---|---|---|---|---|---|---|"]
  for name, kind in NATIVE_TYPES.items():
    how = "" if name in declared else " (ContactSensorCfg)" if name == "contact" else " (MJCF only)"
    relative = ", ".join(kind.references) + (" (needed)" if kind.needs_reference else "")
    numbers, stage = compiled.get(kind.enum, ("settings", "acceleration"))
    numbers = "settings" if name in ("rangefinder", "tactile") else numbers
    cells = f"`{name}`{how}", ", ".join(kind.objects), relative, numbers, kind.frame, kind.unit, stage
    rows.append(f"| {' | '.join(str(cell) or '-' for cell in cells)} |")
  assert "\n".join(rows) in REFERENCE.read_text(), "\n".join(rows)


def test_readings_turn_with_the_world_as_their_frame_says() -> None:
  readings = []
  for angle in (0.0, np.pi / 2):
    spec = scene()
    # The whole world turned about the vertical, which neither gravity nor a plane notices.
    turned = mujoco.MjSpec()
    turned.option.magnetic = Rotation.from_euler("z", angle).apply(turned.option.magnetic)
    turned.attach(spec, prefix="", frame=turned.worldbody.add_frame(quat=[np.cos(angle / 2), 0, 0, np.sin(angle / 2)]))
    sim, sensors = simulate(turned, *each_type(relative=False), num_envs=1)
    velocity = torch.linspace(-1.0, 1.0, sim.mj_model.nv, dtype=sim.dtype)
    for joint in range(sim.mj_model.njnt):
      if sim.mj_model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
        first = sim.mj_model.jnt_dofadr[joint]
        velocity[first : first + 3] = torch.from_numpy(
          Rotation.from_euler("z", angle).apply(velocity[first : first + 3].numpy())
        )
    sim.data.qvel[:], sim.data.ctrl[:] = velocity, 0.5
    for _ in range(5):
      sim.step()
    readings.append([sensor.data[0].clone().numpy() for sensor in sensors])
  turn = Rotation.from_euler("z", np.pi / 2)
  for (name, *_), before, after in zip(OBJECTS, *readings, strict=True):
    kind = NATIVE_TYPES[name]
    if kind.frame in ("world", "reference") and len(before) % 3 == 0:
      expected = turn.apply(before.reshape(-1, 3)).ravel()
      assert not np.allclose(before, after, atol=1e-9) or np.allclose(expected, before, atol=1e-9), name
    elif kind.frame == "reference":
      expected = (turn * Rotation.from_quat(before, scalar_first=True)).as_quat(scalar_first=True)
      expected *= np.sign(expected @ after)
    else:
      expected = before
    np.testing.assert_allclose(after, expected, atol=1e-9, err_msg=name)


def test_a_rangefinder_measures_the_chosen_quantities() -> None:
  fields: Any = ("dist", "origin", "point", "depth")
  _, (sensor,) = build(BuiltinSensorCfg(sensor_type="rangefinder", obj=ref("camera", "watch"), ray_data=fields))
  rays = sensor.data[0].unflatten(0, (12, 8))
  distance, origin, point, depth = rays[:, 0], rays[:, 1:4], rays[:, 4:7], rays[:, 7]
  hit = distance > 0
  assert hit.any()
  assert not hit.all()
  torch.testing.assert_close((point - origin).norm(dim=1)[hit], distance[hit])
  # The camera looks along y.
  torch.testing.assert_close(depth[hit], (point - origin)[hit][:, 1])
  assert (depth[~hit] == -1).all()


def test_enclosed_measures_how_far_an_object_reaches_out() -> None:
  cfg = BuiltinSensorCfg(sensor_type="insidesite", obj=ref("geom", "shell"), ref=ref("site", "zone"), enclosed=True)
  sim, (sensor,) = build(cfg)
  # A box of half height 0.3 in one of 0.4 around the same height, 0.2 wide along y in 0.3.
  assert sensor.data[0].item() == pytest.approx(-0.1)
  sim.data.qpos[0, 2] += 0.25
  assert sensor.data[0].item() == pytest.approx(0.15)


def test_sensor_types_of_mjcf_alone_are_read() -> None:
  _, (sensor,) = build(BuiltinSensorCfg(element="robot/mine"), elements='<user name="mine" dim="3"/>')
  assert sensor.data.shape == (2, 3)


def test_an_existing_element_is_wrapped_by_its_full_name() -> None:
  sim, (named, renamed) = build(
    BuiltinSensorCfg(name="robot/tilt", element="robot/tilt"), BuiltinSensorCfg(name="gyro", element="robot/imu_gyro")
  )
  assert sim.mj_model.nsensor == 2
  sim.data.qvel[:, 3:6] = torch.tensor((1.0, 2.0, 3.0), dtype=sim.dtype)
  # The site's x axis is the body's -z, its z axis the body's x.
  torch.testing.assert_close(renamed.data[0], torch.tensor((-3.0, 2.0, 1.0), dtype=sim.dtype))
  torch.testing.assert_close(named.data[0].norm(), torch.tensor(1.0, dtype=sim.dtype))


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
