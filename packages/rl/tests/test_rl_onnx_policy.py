"""Exported policies are read by the meaning of their inputs, and compared with the environment."""

from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from mjlab_core.errors import FileError
from mjlab_rl import FinitePolicy, OnnxPolicy, RslRlOnPolicyRunnerCfg
from rl_onnx_files import linear_policy
from rl_point_env import PointEnv, PointEnvCfg, PointSceneCfg

AGENT = RslRlOnPolicyRunnerCfg()
JOINTS = ("hip", "knee", "ankle")


class ArmAction:
  cfg = SimpleNamespace(entity="robot")
  target_names: tuple[str, ...] = JOINTS
  scale = torch.tensor([[0.25, 0.25, 0.0745]])


@dataclass
class Layout:
  name: str
  shape: tuple[int, ...]
  frame_shape: tuple[int, ...]
  history_length: int = 0
  clip: tuple[float, float] | None = None
  scale: Any = None


LAYOUTS = [
  Layout("joint_pos", (3,), (3,), scale=0.5),
  Layout("joint_vel", (6,), (3,), history_length=2, clip=(-2.0, 2.0)),
]


class ArmEnv(PointEnv):
  """The parts of an environment with three joints that a policy file can describe."""

  def __init__(self) -> None:
    super().__init__(PointEnvCfg(scene=PointSceneCfg(num_envs=2)))
    motors = {"target_names_expr": ("hip", "knee"), "transmission_type": "joint"}
    actuators = (SimpleNamespace(**motors, stiffness=40.0, damping={".*": 2.0}),)
    robot = SimpleNamespace(
      joint_names=JOINTS,
      data=SimpleNamespace(default_joint_pos=torch.tensor([[0.1, -0.2, 0.3333]])),
      cfg=SimpleNamespace(articulation=SimpleNamespace(actuators=actuators)),
    )
    self.action = ArmAction()
    self.scene = {"robot": robot}
    self.layouts = LAYOUTS
    manager: Any = SimpleNamespace(active_terms=["joint_pos"], get_term=lambda _: self.action, total_action_dim=3)
    self.action_manager = manager
    self.command_manager = SimpleNamespace(active_terms=["twist"], get_term=lambda _: SimpleNamespace())
    self.observation_manager = SimpleNamespace(layout=lambda _: self.layouts)

  def get_observations(self) -> dict[str, torch.Tensor]:
    return {"actor": torch.arange(18.0).reshape(2, 9)}


METADATA = {
  "run_path": "team/project/run",
  "joint_names": "hip,knee,ankle",
  "joint_stiffness": "40.000,40.000,99.000",
  "joint_damping": "2.000,2.000,99.000",
  "default_joint_pos": "0.100,-0.200,0.333",
  "command_names": "twist",
  "observation_names": "joint_pos,joint_vel",
  "observation_terms_scale": "0.500,1.000",
  "observation_terms_history_length": "0.000,2.000",
  "observation_terms_flatten_history_dim": "1.000,1.000",
  "observation_terms_clip": "-inf;inf,-2.000;2.000",
  "action_scale": "0.250,0.250,0.075",
}
WEIGHTS = np.linspace(-1, 1, 27).reshape(9, 3)


def test_a_file_that_fits_acts(tmp_path: Path) -> None:
  env = ArmEnv()
  policy = OnnxPolicy(linear_policy(tmp_path / "p.onnx", WEIGHTS, metadata=METADATA), AGENT, env)
  seen = env.get_observations()
  torch.testing.assert_close(policy(seen), seen["actor"] @ torch.tensor(WEIGHTS, dtype=torch.float32))


@pytest.mark.parametrize("batch", [1, "batch"])
def test_inputs_are_fed_by_their_name_and_outputs_of_a_motion_are_ignored(tmp_path: Path, batch: Any) -> None:
  """Class of mistakes: an input is taken for another because of its position."""
  env = ArmEnv()
  file = linear_policy(tmp_path / "p.onnx", WEIGHTS, time_step=True, memory=True, batch=batch)
  policy = OnnxPolicy(file, AGENT, env)
  seen = env.get_observations()
  plain = seen["actor"] @ torch.tensor(WEIGHTS, dtype=torch.float32)
  for call in (1.0, 2.0):
    env.episode_length_buf += 4
    torch.testing.assert_close(policy(seen), plain + call)
  policy.reset(torch.tensor([True, False]))
  torch.testing.assert_close(policy(seen), plain + torch.tensor([[1.0], [3.0]]))


@pytest.mark.parametrize(
  ("key", "value", "message"),
  [
    ("joint_names", "knee,hip,ankle", "joint_names: knee, hip, ankle in the file and hip, knee, ankle here"),
    ("joint_names", "hip,knee,wrist", "joint_names: wrist in the file and ankle here, from position 2"),
    ("joint_names", "hip,knee", "joint_names: nothing in the file and ankle here, from position 2"),
    ("joint_stiffness", "41.000,40.000,0.000", "joint_stiffness: 'hip' has 41 in the file and 40 here"),
    ("joint_damping", "2.000,2.000", "metadata 'joint_damping' has 2 values, but there are 3 items"),
    ("default_joint_pos", "0.100,-0.200,0.300", "default_joint_pos: 'ankle' has 0.3 in the file and 0.3333 here"),
    ("command_names", "motion", "command_names: motion in the file and twist here, from position 0"),
    ("observation_names", "joint_vel,joint_pos", "observation_names: joint_vel, joint_pos in the file and joint_pos"),
    ("observation_terms_scale", "0.500,2.000", "observation_terms_scale: 'joint_vel' has 2 in the file and 1 here"),
    ("observation_terms_history_length", "0,5", "observation_terms_history_length: 'joint_vel' has 5 in the file"),
    ("observation_terms_flatten_history_dim", "1,0", "observation_terms_flatten_history_dim: 'joint_vel'"),
    ("observation_terms_clip", "-inf;inf,-1;1", "observation_terms_clip: 'joint_vel' has -1, 1 in the file and -2, 2"),
    ("action_scale", "0.500", "action_scale: 'hip' has 0.5 in the file and 0.25 here"),
    ("joint_stiffness", "a,b,c", "metadata 'joint_stiffness' has a value that is not a number: "),
  ],
)
def test_a_difference_between_metadata_and_environment_is_refused_by_name(
  tmp_path: Path, key: str, value: str, message: str
) -> None:
  file = linear_policy(tmp_path / "p.onnx", WEIGHTS, metadata=METADATA | {key: value})
  with pytest.raises(FileError) as caught:
    OnnxPolicy(file, AGENT, ArmEnv())
  assert str(caught.value).startswith(f"policy {file}: ")
  assert message in str(caught.value)


def test_actions_in_another_order_than_the_joints_of_the_file_are_refused(tmp_path: Path) -> None:
  env = ArmEnv()
  env.action.target_names = ("ankle", "hip", "knee")
  file = linear_policy(tmp_path / "p.onnx", WEIGHTS, metadata={"joint_names": METADATA["joint_names"]})
  with pytest.raises(FileError, match="joint_names: the actions are in another order here: ankle, hip, knee"):
    OnnxPolicy(file, AGENT, env)


@pytest.mark.parametrize(
  ("options", "message"),
  [
    ({"other": "wind"}, r"Required inputs \(\['wind'\]\) are missing"),
    ({"weights": np.ones((7, 3))}, "invalid dimensions for input: obs .* Got: 9 Expected: 7"),
    ({"weights": np.ones((9, 2))}, r"its actions are \(1, 2\), the environment takes \(1, 3\)"),
  ],
)
def test_a_network_that_does_not_fit_is_refused_by_name(tmp_path: Path, options: Any, message: str) -> None:
  env, file = ArmEnv(), linear_policy(tmp_path / "p.onnx", **({"weights": WEIGHTS} | options))
  with pytest.raises(FileError, match=message):
    OnnxPolicy(file, AGENT, env)(env.get_observations())


def test_a_history_of_one_frame_equals_a_term_without_history(tmp_path: Path) -> None:
  env = ArmEnv()
  env.layouts = [replace(LAYOUTS[0], history_length=1), LAYOUTS[1]]
  OnnxPolicy(linear_policy(tmp_path / "p.onnx", WEIGHTS, metadata=METADATA), AGENT, env)


def test_actions_that_are_not_finite_are_counted(tmp_path: Path) -> None:
  env, calls = ArmEnv(), []
  weights = WEIGHTS.copy()
  weights[0] = np.inf
  policy = FinitePolicy(OnnxPolicy(linear_policy(tmp_path / "p.onnx", weights), AGENT, env), lambda: calls.append(1))
  seen = {"actor": torch.zeros(2, 9)}
  assert policy.num_broken == 0
  for _ in range(3):
    # 0 x infinity is NaN.
    policy(seen)
  assert policy.num_broken == 6
  assert calls == [1]
