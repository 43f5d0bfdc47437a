"""A small bundle: a pole on a hinge with a position servo, and a linear policy."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import onnx
from mjlab_deploy import (
  Command,
  Description,
  Golden,
  Input,
  Joint,
  Memory,
  Observation,
  Origin,
  Policy,
  Robot,
  Target,
  Timing,
  open_bundle,
  write_description,
)
from mjlab_deploy.arrays import write_arrays
from onnx import TensorProto, helper, numpy_helper

KP, KD, EFFORT = 20.0, 2.0, 5.0
DEFAULT, SCALE = 0.1, 0.25
WEIGHTS = np.array([[-0.4], [-0.05], [0.1], [2.0]], np.float32)

SCENE = f"""
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.005" integrator="implicitfast"/>
  <worldbody>
    <body name="robot/pole">
      <joint name="robot/hinge" type="hinge" axis="0 1 0" range="-2 2" armature="0.01"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.5" size="0.02" mass="0.2"/>
    </body>
  </worldbody>
  <actuator>
    <position name="robot/hinge" joint="robot/hinge" kp="{KP}" kv="{KD}" forcerange="-{EFFORT} {EFFORT}"/>
  </actuator>
</mujoco>
"""

DESCRIPTION = Description(
  task="Test-Pole",
  robot=Robot(
    name="robot",
    joints=(
      Joint(
        name="hinge",
        default_position=DEFAULT,
        is_driven=True,
        stiffness=KP,
        damping=KD,
        armature=0.01,
        effort_limit=EFFORT,
        velocity_limit=20.0,
        position_range=(-2.0, 2.0),
      ),
    ),
    root_body="pole",
    is_floating=False,
  ),
  timing=Timing(physics_dt=0.005, decimation=4, episode_steps=200),
  inputs=(
    Input(
      name="joint/position",
      shape=(1,),
      unit="rad",
      columns=("hinge",),
      origin=Origin(quantity="joint_position"),
    ),
    Input(
      name="joint/velocity",
      shape=(1,),
      unit="rad/s",
      columns=("hinge",),
      origin=Origin(quantity="joint_velocity"),
    ),
    Input(name="command/angle", shape=(1,), unit="rad", columns=("angle",)),
  ),
  memories=(Memory(input="memory/last_action", output="memory/last_action/next", shape=(1, 1)),),
  targets=(Target(name="target/position", quantity="position", joints=("hinge",)),),
  observations=tuple(
    Observation(group="actor", name=name, columns=(i, i + 1), shape=(1,), sources=(source,))
    for i, (name, source) in enumerate(
      (
        ("joint_pos", "joint/position"),
        ("joint_vel", "joint/velocity"),
        ("actions", "last_action"),
        ("command", "command/angle"),
      )
    )
  ),
  action_names=("hinge",),
  action_scale=(SCALE,),
  commands=(Command(input="command/angle", ranges={"angle": (-0.5, 0.5)}),),
  has_scene=True,
)


def graph() -> onnx.ModelProto:
  def value(name: str) -> Any:
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 1])

  constants = {
    "default": np.array([[DEFAULT]], np.float32),
    "weights": WEIGHTS,
    "scale": np.array([[SCALE]], np.float32),
  }
  nodes = [
    helper.make_node("Sub", ["joint/position", "default"], ["position"]),
    helper.make_node(
      "Concat", ["position", "joint/velocity", "memory/last_action", "command/angle"], ["observation/actor"], axis=1
    ),
    helper.make_node("MatMul", ["observation/actor", "weights"], ["action"]),
    helper.make_node("Identity", ["action"], ["memory/last_action/next"]),
    helper.make_node("Mul", ["action", "scale"], ["shift"]),
    helper.make_node("Add", ["shift", "default"], ["target/position"]),
  ]
  model = helper.make_model(
    helper.make_graph(
      nodes,
      "policy",
      [value(name) for name in ("joint/position", "joint/velocity", "command/angle", "memory/last_action")],
      [value(name) for name in ("action", "target/position", "memory/last_action/next")]
      + [helper.make_tensor_value_info("observation/actor", TensorProto.FLOAT, [1, 4])],
      [numpy_helper.from_array(array, name) for name, array in constants.items()],
    ),
    opset_imports=[helper.make_opsetid("", 18)],
  )
  model.ir_version = 9
  return model


def write_bundle(folder: Path, description: Description = DESCRIPTION, *, golden: bool = True) -> Path:
  """Write a bundle, with a record of 100 steps of its own scene."""
  folder.mkdir(parents=True, exist_ok=True)
  onnx.save(graph(), folder / "policy.onnx")
  (folder / "scene.xml").write_text(SCENE)
  write_description(folder, description)
  if golden:
    _record(folder)
    write_description(folder, replace(description, golden=Golden(steps=100, engine="native")))
  return folder


def _record(folder: Path) -> None:
  model = mujoco.MjModel.from_xml_string(SCENE)
  data = mujoco.MjData(model)
  data.qpos[0] = 0.4
  rows: dict[str, list[np.ndarray]] = {}
  with open_bundle(folder) as bundle:
    policy = Policy(bundle)
    for step in range(100):
      readings = {
        "joint/position": data.qpos.copy(),
        "joint/velocity": data.qvel.copy(),
        "command/angle": np.array([0.3 if step < 50 else -0.3]),
      }
      rows.setdefault("state/qpos", []).append(data.qpos.copy())
      rows.setdefault("state/qvel", []).append(data.qvel.copy())
      rows.setdefault("episode_start", []).append(np.array(step == 0, np.float32))
      result = policy.step(readings)
      for name, array in readings.items():
        rows.setdefault(f"input/{name}", []).append(array.astype(np.float32))
      rows.setdefault("observation/actor", []).append(result.observations["actor"])
      rows.setdefault("action", []).append(result.action)
      rows.setdefault("target/position", []).append(result.targets["target/position"])
      data.ctrl[:] = result.targets["target/position"]
      for _ in range(4):
        mujoco.mj_step(model, data)
  write_arrays(folder / "golden.npz", {name: np.stack(values) for name, values in rows.items()})
