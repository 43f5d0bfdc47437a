"""`mjlab new robot` writes packages that build, install and stand."""

import importlib
import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from mjlab.cli import main
from mjlab_actuators import NativePositionActuatorCfg, NativeVelocityActuatorCfg, XmlActuatorCfg
from mjlab_scene import Scene, SceneCfg
from new_package import install, run_tests
from PIL import Image

QUADRUPED = Path(__file__).parent / "models" / "quadruped.xml"

BIPED_URDF = (
  """<robot name="x"><link name="pelvis"><inertial><mass value="8"/>
  <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><geometry><box size="0.1 0.2 0.2"/></geometry></collision></link>"""
  + "".join(
    f"""<link name="{side}_leg"><inertial><origin xyz="0 0 -0.2"/><mass value="2"/>
  <inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><origin xyz="0 0 -0.2"/><geometry><cylinder radius="0.03" length="0.4"/></geometry></collision></link>
  <joint name="{side}_hip" type="revolute"><parent link="pelvis"/><child link="{side}_leg"/>
  <origin xyz="0 {y} -0.2"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="60" velocity="20"/></joint>"""
    for side, y in (("left", 0.1), ("right", -0.1))
  )
  + "</robot>"
)
ARM = """
<mujoco><worldbody><body name="base"><geom type="box" size="0.1 0.1 0.02" pos="0 0 0.02"/>
  <body name="upper" pos="0 0 0.1"><joint name="a&quot;b\\d" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.03"/>
    <body name="lower" pos="0 0 0.3"><joint name="elbow" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.2" size="0.02"/>
    </body></body></body></worldbody>
  <tendon><fixed name="cable"><joint joint="elbow" coef="1"/></fixed></tendon>
  <actuator><position joint="a&quot;b\\d" kp="100" kv="10" gear="2" forcerange="-5 5"/>
    <motor tendon="cable"/></actuator></mujoco>"""


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
  monkeypatch.chdir(tmp_path)


def written(name: str, text: str) -> Path:
  path = Path(name)
  path.write_text(text)
  return path


def module(name: str, monkeypatch: pytest.MonkeyPatch) -> Any:
  """Import the package from its source, for this test alone."""
  monkeypatch.syspath_prepend(str(Path(name, "src").resolve()))
  for known in [known for known in sys.modules if known.partition(".")[0] == name]:
    monkeypatch.delitem(sys.modules, known)
  return importlib.import_module(name)


def test_a_quadruped_becomes_a_package_that_builds_installs_and_stands(
  monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
  assert main(["new", "robot", str(QUADRUPED), "--name", "four_legs"]) == 0
  said = capsys.readouterr().out
  assert "feet: FL_calf, FR_calf, RL_calf, RR_calf" in said
  assert "does not stay" not in said
  install(Path("four_legs"), into=Path("installed"))
  run_tests(Path("four_legs"), installed=Path("installed").resolve())
  monkeypatch.syspath_prepend(str(Path("installed").resolve()))
  robot = importlib.import_module("four_legs")
  assert robot.TORSO == "base"
  assert "floor" not in {geom.name for geom in robot.four_legs_spec().geoms}
  scene = Scene(SceneCfg(num_envs=1, entities={"robot": robot.four_legs()}))
  assert scene["robot"].joint_names[:3] == ("FL_hip_joint", "FL_thigh_joint", "FL_calf_joint")
  limits = {cfg.effort_limit for cfg in robot.ACTUATORS}
  assert limits == {24.0, 45.0}
  if (picture := Path("four_legs/robot.png")).exists():
    pixels = np.asarray(Image.open(picture))
    assert pixels.std() > 10.0
    # The ground and sky are those of the page.
    assert np.median(pixels) > 230


def test_a_urdf_floats_if_two_chains_end_in_it_and_takes_its_effort_limits(
  monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
  file = written("Two Legs!.urdf", BIPED_URDF)
  assert main(["new", "robot", str(file)]) == 0
  assert "the base is a guess from the URDF: floating" in capsys.readouterr().out
  robot = module("two_legs", monkeypatch)
  assert robot.FOOT_BODIES == ("left_leg", "right_leg")
  assert [joint.type for joint in robot.two_legs_spec().bodies[1].joints] == [mujoco.mjtJoint.mjJNT_FREE]
  assert {cfg.effort_limit for cfg in robot.ACTUATORS} == {60.0}


def test_an_arm_keeps_its_servo_gains_and_tendon_actuators(
  monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
  assert main(["new", "robot", str(written("arm.xml", ARM)), "--motors", "elbow=9,0.01,20"]) == 0
  robot = module("arm", monkeypatch)
  first, second, tendon = robot.ACTUATORS
  assert isinstance(first, NativePositionActuatorCfg)
  # A gear of 2 moves the servo twice as far, with twice its force.
  assert (first.stiffness, first.damping, first.effort_limit) == (400.0, 40.0, 10.0)
  assert (second.effort_limit, second.armature, second.velocity_limit) == (9.0, 0.01, 20.0)
  assert isinstance(tendon, XmlActuatorCfg)
  assert tendon.transmission_type == "tendon"
  assert robot.FEET == ()
  names = Scene(SceneCfg(num_envs=1, entities={"robot": robot.arm()}))["robot"].joint_names
  assert names == ('a"b\\d', "elbow")
  assert "base: fixed" in capsys.readouterr().out


def test_the_motor_of_a_wheel_becomes_a_velocity_servo(monkeypatch: pytest.MonkeyPatch) -> None:
  wheel = """<body name="{0}" pos="0 {1} 0"><joint name="{0}_axle" axis="0 1 0"/>
    <geom type="cylinder" size="0.1 0.02" quat="0.7071 0.7071 0 0"/></body>"""
  xml = f"""<mujoco><worldbody><body name="box"><freejoint/><geom type="box" size="0.1 0.1 0.05" pos="0 0 0.2"/>
    {wheel.format("left", 0.2)}{wheel.format("right", -0.2)}</body></worldbody></mujoco>"""
  assert main(["new", "robot", str(written("cart.xml", xml)), "--motors", ".*=2"]) == 0
  (servo,) = module("cart", monkeypatch).ACTUATORS
  assert isinstance(servo, NativeVelocityActuatorCfg)


def test_nothing_is_overwritten_and_no_name_is_taken_twice(capsys: pytest.CaptureFixture[str]) -> None:
  Path("mine").mkdir()
  kept = written("mine/kept.txt", "kept")
  assert main(["new", "robot", str(QUADRUPED), "--output", "mine"]) == 2
  assert "mine exists; nothing is overwritten" in capsys.readouterr().err
  assert [path.name for path in Path("mine").iterdir()] == [kept.name]
  assert main(["new", "robot", str(QUADRUPED), "--name", "mujoco"]) == 2
  assert main(["new", "robot", str(QUADRUPED), "--name", "../up"]) == 2
  assert sorted(path.name for path in Path().iterdir()) == ["mine"]


LINK = '<body name="b"><joint name="j"/><geom size="0.1"/></body>'


@pytest.mark.parametrize(
  ("file", "text", "flags", "code", "message"),
  [
    ("a.txt", "", [], 1, "robot "),
    ("a.xml", "<mujoco>", [], 1, "a.xml: "),
    ("a.xml", "<mujoco><worldbody>\x1b[31m</worldbody>", [], 1, "a.xml: "),
    ("a.urdf", "<robot/>", [], 1, "expected one body at the top level"),
    ("a.xml", "<mujoco/>", [], 1, "expected one body at the top level"),
    ("a.xml", f"<mujoco><worldbody>{LINK}</worldbody></mujoco>", [], 1, "no joint has an actuator or an effort limit"),
    ("a.xml", f"<mujoco><worldbody>{LINK}</worldbody></mujoco>", ["--motors", "k=1"], 2, "matches no joint"),
    ("a.xml", f"<mujoco><worldbody>{LINK}</worldbody></mujoco>", ["--motors", "j=nan"], 2, "positive numbers"),
    ("a.xml", f"<mujoco><worldbody>{LINK}</worldbody></mujoco>", ["--motors", "j(=1"], 2, "--motors"),
    ("a.xml", f"<mujoco><worldbody>{LINK}</worldbody></mujoco>", ["--home", "j=x"], 2, "must be PATTERN=POSITION"),
    ("a.xml", f"<mujoco><worldbody>{LINK}</worldbody></mujoco>", ["--torso", "c"], 2, "matches no body"),
    ("a.xml", f"<mujoco><worldbody>{LINK}</worldbody></mujoco>", ["--feet", "c"], 2, "matches no body"),
    (
      "a.xml",
      f"""<mujoco><worldbody><body name="a"><joint name="ball" type="ball"/><geom size="0.1"/>{LINK}</body></worldbody>
      <actuator><motor name="m" joint="ball"/></actuator></mujoco>""",
      [],
      1,
      "actuator 'm' drives neither a hinge nor a slide",
    ),
    (
      "a.xml",
      '<mujoco><asset><mesh file="gone.stl"/></asset><worldbody><body name="b"/></worldbody></mujoco>',
      [],
      1,
      "a.xml: ",
    ),
  ],
)
def test_a_mistake_is_one_line_and_writes_nothing(
  file: str, text: str, flags: list[str], code: int, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
  path = written(file, text)
  assert main(["new", "robot", str(path), *flags, "--name", "mine"]) == code
  error = capsys.readouterr().err
  assert message in error
  assert len(error.splitlines()) == 1
  assert error.rstrip("\n").isprintable()
  assert [found.name for found in Path().iterdir()] == [file]


@pytest.mark.parametrize("words", [[], ["robt"], ["robot"]])
def test_a_wrong_command_line_shows_the_form(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
  assert main(["new", *words]) == 2
  assert "usage: new robot FILE" in capsys.readouterr().err
