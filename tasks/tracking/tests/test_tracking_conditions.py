"""Terminations and errors that no task of this package uses, against NumPy."""

from pathlib import Path

import numpy as np
import pytest
import torch
from mjlab_core.errors import ConfigError
from mjlab_managers import MetricsTermCfg, TerminationTermCfg
from mjlab_tracking.mdp import bad_anchor_pos, bad_motion_body_pos, body_orientation_error, body_position_error, mpkpe
from mjlab_tracking.mdp.errors import body_angle, body_distance
from tracking_env import make, root_pose, still

HANDS = ("left_wrist_yaw_link", "right_wrist_yaw_link")


def test_distances_in_space_end_episodes_and_are_measured_over_named_bodies(folder: Path) -> None:
  cfg = still(folder, failures=False)
  params = {"command": "motion", "threshold": 0.3}
  cfg.terminations["far"] = TerminationTermCfg(bad_anchor_pos, params=params)
  cfg.terminations["hands"] = TerminationTermCfg(bad_motion_body_pos, params=params | {"bodies": HANDS})
  cfg.terminations["any"] = TerminationTermCfg(bad_motion_body_pos, params=params)
  cfg.metrics = {
    "hands": MetricsTermCfg(body_position_error, params={"command": "motion", "bodies": HANDS}),
    "turned": MetricsTermCfg(body_orientation_error, params={"command": "motion", "bodies": HANDS}),
  }
  env, term = make(cfg)
  robot = env.scene["robot"]
  state = root_pose(env)
  # Each of the two parts is below the threshold, their norm is not.
  state[:, 0] += torch.tensor([0.0, 0.25, 0.25, 0.0])
  state[:, 2] += torch.tensor([0.0, 0.0, 0.25, 0.25])
  robot.write_root_pose(state)
  joints = robot.data.joint_pos.clone()
  joints[3, robot.joint_names.index("left_shoulder_pitch_joint")] -= 1.5
  robot.write_joint_position(joints)

  def ended(name: str) -> list[bool]:
    return env.termination_manager.term(name)().tolist()

  assert ended("far") == [False, False, True, False]
  error = (term.body_pos_relative_w - term.robot_body_pos_w).numpy()
  distance = np.linalg.norm(error, axis=-1)
  columns = [term.cfg.bodies.index(hand) for hand in HANDS]
  assert ended("hands") == (distance[:, columns] > 0.3).any(1).tolist() == [False, False, False, True]
  assert ended("any") == (distance > 0.3).any(1).tolist()
  values = {name: env.metrics_manager.term(name)() for name in ("hands", "turned")}
  torch.testing.assert_close(values["hands"], body_distance(term)[:, columns].mean(-1))
  torch.testing.assert_close(values["turned"], body_angle(term)[:, columns].mean(-1))
  in_world = np.linalg.norm((term.body_pos_w - term.robot_body_pos_w).numpy(), axis=-1).mean(1)
  np.testing.assert_allclose(mpkpe(env, command="motion").numpy(), in_world, rtol=1e-6)
  assert in_world[1] == pytest.approx(0.25, abs=0.03)


def test_a_body_that_is_not_followed_is_named(folder: Path) -> None:
  cfg = still(folder)
  params = {"command": "motion", "threshold": 0.3, "bodies": ("tail",)}
  cfg.terminations["hands"] = TerminationTermCfg(bad_motion_body_pos, params=params)
  with pytest.raises(ConfigError, match="followed bodies: body 'tail' does not exist"):
    make(cfg)
