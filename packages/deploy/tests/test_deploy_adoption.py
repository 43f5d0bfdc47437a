"""Networks of other projects run by their metadata."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from deploy_bundles import DEFAULT, EFFORT, KD, KP, SCALE, SCENE, SERVO, save_graph
from mjlab_deploy import Policy
from mjlab_deploy.command import main
from mjlab_deploy.formats.adoption import adopted
from mjlab_deploy.simulation.simulated_run import SimulatedRun
from onnx import helper

METADATA = {
  "joint_names": "hinge",
  "joint_stiffness": str(KP),
  "joint_damping": str(KD),
  "default_joint_pos": str(DEFAULT),
  "action_scale": str(SCALE),
  "observation_names": "joint_pos,joint_vel,actions,command",
  "observation_terms_scale": "1.000,0.500,1.000,1.000;1.000;2.000",
  "observation_terms_clip": "-inf;inf,-1.000;1.000,-inf;inf,-inf;inf",
  "observation_terms_history_length": "0.0,2.0,0.0,0.0",
}
WEIGHTS = np.array([[-0.4], [0.3], [-0.05], [0.1], [2.0], [0.0], [0.0]], np.float32)


def network(path: Path, output: str = "actions", /, **metadata: str | None) -> Path:
  """Write actions = obs @ WEIGHTS with metadata; None leaves out a key."""

  known = {key: text for key, text in {**METADATA, **metadata}.items() if text is not None}
  nodes = [helper.make_node("MatMul", ["obs", "weights"], [output])]
  save_graph(path, nodes, {"obs": len(WEIGHTS)}, {output: 1}, known, weights=WEIGHTS)
  return path


# Unitree's description of the same network.
DEPLOY = {
  "motor_names": ["hinge"], "joint_ids_map": [0], "step_dt": 0.02, "stiffness": [KP], "damping": [KD],
  "default_joint_pos": [DEFAULT], "actions": {"JointPositionAction": {"scale": SCALE, "offset": [DEFAULT]}},
  "observations": {
    "joint_pos_rel": {}, "joint_vel_rel": {"scale": [0.5], "clip": [-1.0, 1.0], "history_length": 2},
    "last_action": {}, "velocity_commands": {"scale": [1.0, 1.0, 2.0]},
  },
}  # fmt: skip


@pytest.fixture
def robot(tmp_path: Path) -> Path:
  """The pole under its own names, with a motor and a keyframe, which the policy's servo replaces."""
  motor = f'<motor name="motor" joint="hinge" forcerange="-{EFFORT} {EFFORT}" forcelimited="true"/>'
  text = SCENE.replace(SERVO, motor).replace("robot/", "")
  text = text.replace("</mujoco>", '<keyframe><key name="home" qpos="0.1" ctrl="0"/></keyframe></mujoco>')
  path = tmp_path / "pole.xml"
  path.write_text(text)
  return path


@pytest.fixture
def refusal(robot: Path, capsys: pytest.CaptureFixture[str]) -> Callable[[Path], str]:
  """Return a function that runs a network, which is refused in one line, and returns the line."""

  def run(path: Path) -> str:
    assert main(["run", str(path), "--model", str(robot)]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    return error

  return run


def test_a_network_gets_the_observation_that_its_metadata_describes(tmp_path: Path, robot: Path) -> None:
  with adopted(network(tmp_path / "policy.onnx"), robot) as bundle:
    (joint,) = bundle.description.robot.joints
    assert (joint.stiffness, joint.damping, joint.effort_limit) == (KP, KD, EFFORT)
    policy = Policy(bundle)
  action, before = 0.0, -0.5
  for i, velocity in enumerate((-1.0, 0.4, 3.0)):
    readings = {"joint/position": [0.4], "joint/velocity": [velocity], "command/velocity": [0.2, 0.1, 0.3]}
    step = policy.step({name: np.array(value) for name, value in readings.items()})
    now = 0.5 * float(np.clip(velocity, -1.0, 1.0))
    seen = [0.4 - DEFAULT, now if i == 0 else before, now, action, 0.2, 0.1, 0.6]
    np.testing.assert_allclose(step.observations["actor"], seen, rtol=1e-5)
    action, before = float(np.array(seen) @ WEIGHTS[:, 0]), now
    np.testing.assert_allclose(step.targets["target/position"], [DEFAULT + SCALE * action], rtol=1e-5)


def test_a_network_of_playground_gets_its_observation_from_a_description_beside_it(tmp_path: Path, robot: Path) -> None:
  """MuJoCo Playground exports "obs" to "continuous_actions" without metadata; its robots are not only Unitree's."""
  path = network(tmp_path / "policy.onnx", "continuous_actions", **dict.fromkeys(METADATA))
  (tmp_path / "deploy.yaml").write_text(json.dumps(DEPLOY))
  readings = {"joint/position": [0.4], "joint/velocity": [3.0], "command/velocity": [0.2, 0.1, 0.3]}
  steps = []
  for file in (path, network(tmp_path / "with_metadata.onnx")):
    with adopted(file, robot) as bundle:
      policy = Policy(bundle)
    steps.append([policy.step({name: np.array(value) for name, value in readings.items()}) for _ in range(2)])
  for own, other in zip(*steps, strict=True):
    assert own.observations["actor"] == pytest.approx(other.observations["actor"])
    assert own.targets["target/position"] == pytest.approx(other.targets["target/position"])
    assert own.action != 0.0


PUBLISHED = Path(os.environ.get("MJLAB_PUBLISHED_POLICIES", "/nowhere"))


@pytest.mark.parametrize("policy", sorted(PUBLISHED.rglob("*.onnx")) or [None], ids=str)
def test_published_policies_run(policy: Path | None) -> None:
  if policy is None:
    pytest.skip("set MJLAB_PUBLISHED_POLICIES to folders with a network, robot.xml and, without metadata, deploy.yaml")
  with adopted(policy, policy.parent / "robot.xml") as bundle:
    run = SimulatedRun(bundle)
    run.run(10.0)
    assert run.runner.phase == "policy", run.runner.reason


def test_a_network_runs_from_the_command_line(tmp_path: Path, robot: Path, capsys: pytest.CaptureFixture[str]) -> None:
  path = network(tmp_path / "policy.onnx")
  words = ["run", str(path), "--model", str(robot), "--command", "0.5,0,0", "--seconds", "1.5"]
  assert main(words) == 0
  assert "ran 1.5 s" in capsys.readouterr().out
  assert main(["run", str(path)]) == 1
  assert "is a network without a robot; name its MJCF file with --model" in capsys.readouterr().err


@pytest.mark.parametrize(
  ("metadata", "message"),
  [
    ({"joint_names": None}, "metadata of the network 'joint_names' does not exist; there are "),
    ({"joint_names": "elbow"}, "joint 'elbow' does not exist; there are 'hinge'"),
    ({"joint_stiffness": "stiff"}, "metadata 'joint_stiffness' has a value that is not a number: could not convert"),
    ({"observation_names": "joint_pos,joint_vel,actions,phase"}, "observation of the network 'phase' does not exist; "),
    (
      {"observation_names": "joint_pos,joint_vel,actions,actions"},
      "its observation_names give 5 numbers, the network takes 7",
    ),
  ],
)
def test_metadata_that_do_not_fit_are_refused_by_name(
  tmp_path: Path, refusal: Callable[[Path], str], metadata: dict[str, str | None], message: str
) -> None:
  assert message in refusal(network(tmp_path / "policy.onnx", **metadata))


@pytest.mark.parametrize(
  ("change", "message"),
  [
    ({"step_dt": None}, "float"),
    ({"joint_ids_map": [0, 1]}, "joint_ids_map has 2 motors, not those of a G1 with 29, a quadruped"),
    ({"stiffness": []}, "list index out of range"),
    ({"actions": {"JointVelocityAction": {}}}, "action JointVelocityAction is not one of all joints without a clip"),
    ({"default_joint_pos": [0.2]}, "the offset of its action is not the default pose"),
    ({"observations": {"gait_phase": {}}}, "observation of the network 'gait_phase' does not exist"),
    (None, "it has no 'joint_ids_map'"),
    ("]", "expected the node content, but found ']'"),
  ],
)
def test_a_wrong_deploy_yaml_is_one_line(
  tmp_path: Path, refusal: Callable[[Path], str], change: object, message: str
) -> None:
  content = DEPLOY | change if isinstance(change, dict) else change
  (tmp_path / "deploy.yaml").write_text(content if isinstance(content, str) else json.dumps(content))
  assert message in refusal(network(tmp_path / "policy.onnx", **dict.fromkeys(METADATA)))
