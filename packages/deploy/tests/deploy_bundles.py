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

SERVO = f'<position name="robot/hinge" joint="robot/hinge" kp="{KP}" kv="{KD}" forcerange="-{EFFORT} {EFFORT}"/>'
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
  <actuator>{SERVO}</actuator>
</mujoco>
"""

HINGE = Joint(
  name="hinge", default_position=DEFAULT, is_driven=True, stiffness=KP, damping=KD, armature=0.01, effort_limit=EFFORT,
  velocity_limit=20.0, position_range=(-2.0, 2.0),
)  # fmt: skip
SOURCES = {
  "joint_pos": "joint/position",
  "joint_vel": "joint/velocity",
  "actions": "last_action",
  "command": "command/angle",
}
DESCRIPTION = Description(
  task="Test-Pole",
  robot=Robot(name="robot", joints=(HINGE,), root_body="pole", is_floating=False),
  timing=Timing(physics_dt=0.005, decimation=4, episode_steps=200),
  inputs=(
    Input(name="joint/position", shape=(1,), columns=("hinge",), origin=Origin(quantity="joint_position")),
    Input(name="joint/velocity", shape=(1,), columns=("hinge",), origin=Origin(quantity="joint_velocity")),
    Input(name="command/angle", shape=(1,), columns=("angle",)),
  ),
  memories=(Memory(input="memory/last_action", output="memory/last_action/next", shape=(1, 1)),),
  targets=(Target(name="target/position", quantity="position", joints=("hinge",)),),
  observations=tuple(
    Observation(group="actor", name=name, columns=(i, i + 1), shape=(1,), sources=(source,))
    for i, (name, source) in enumerate(SOURCES.items())
  ),
  action_names=("hinge",),
  action_scale=(SCALE,),
  commands=(Command(input="command/angle", ranges={"angle": (-0.5, 0.5)}),),
  has_scene=True,
)


def save_graph(
  path: Path,
  nodes: list[Any],
  inputs: dict[str, int],
  outputs: dict[str, int],
  metadata: dict[str, str] | None = None,
  **constants: Any,
) -> None:
  """Write an ONNX file; inputs and outputs have a width each."""
  given, returned = (
    [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, width]) for name, width in values.items()]
    for values in (inputs, outputs)
  )
  known = [numpy_helper.from_array(np.array(value, np.float32), name) for name, value in constants.items()]
  graph = helper.make_graph(nodes, "policy", given, returned, known)
  model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
  helper.set_model_props(model, metadata or {})
  onnx.save(model, path)


def save_policy(path: Path) -> None:
  inputs = ["joint/position", "joint/velocity", "memory/last_action", "command/angle"]
  nodes = [
    helper.make_node("Sub", ["joint/position", "default"], ["position"]),
    helper.make_node("Concat", ["position", *inputs[1:]], ["observation/actor"], axis=1),
    helper.make_node("MatMul", ["observation/actor", "weights"], ["action"]),
    helper.make_node("Identity", ["action"], ["memory/last_action/next"]),
    helper.make_node("Mul", ["action", "scale"], ["shift"]),
    helper.make_node("Add", ["shift", "default"], ["target/position"]),
  ]
  outputs = {"action": 1, "target/position": 1, "memory/last_action/next": 1, "observation/actor": 4}
  save_graph(path, nodes, dict.fromkeys(inputs, 1), outputs, default=[[DEFAULT]], weights=WEIGHTS, scale=[[SCALE]])


def write_bundle(
  folder: Path, description: Description = DESCRIPTION, *, golden: bool = False, scene: str = SCENE
) -> Path:
  """Write a bundle; `golden` adds a record of 100 steps in its scene."""
  folder.mkdir(parents=True, exist_ok=True)
  save_policy(folder / "policy.onnx")
  (folder / "scene.xml").write_text(scene)
  write_description(folder, description)
  if golden:
    _record(folder)
    write_description(folder, replace(description, golden=Golden(steps=100, engine="native")))
  return folder


def _record(folder: Path) -> None:
  model = mujoco.MjModel.from_xml_string(SCENE)
  data = mujoco.MjData(model)
  data.qpos[0] = 0.4
  rows: list[dict[str, Any]] = []
  with open_bundle(folder) as bundle:
    policy = Policy(bundle)
  for step in range(100):
    state, command = {"qpos": data.qpos.copy(), "qvel": data.qvel.copy()}, np.array([0.3 if step < 50 else -0.3])
    readings = {"joint/position": state["qpos"], "joint/velocity": state["qvel"], "command/angle": command}
    result = policy.step(readings)
    row = {f"state/{name}": value for name, value in state.items()}
    row |= {f"input/{name}": value.astype(np.float32) for name, value in readings.items()}
    row |= {"observation/actor": result.observations["actor"], "action": result.action, **result.targets}
    rows.append(row | {"episode_start": np.array(step == 0, np.float32)})
    data.ctrl[:] = result.targets["target/position"]
    mujoco.mj_step(model, data, nstep=4)
  write_arrays(folder / "golden.npz", {name: np.stack([row[name] for row in rows]) for name in rows[0]})
