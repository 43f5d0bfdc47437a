"""Actions of joints: from the policy's output to targets."""

from typing import Any

import numpy as np
import pytest
import torch
from envs_hopper import Make, actions, hopper_cfg
from mjlab_core.errors import ConfigError
from mjlab_envs import mdp

DEFAULT = np.array([0.2, -0.4])


def acting(make: Make, **terms: Any) -> Any:
  return make(actions=terms, events={}, commands={}, observations={}, rewards={})


def targets(env: Any, action: torch.Tensor, kind: str = "pos") -> np.ndarray:
  env.step(action)
  return getattr(env.scene["robot"].data, f"joint_{kind}_target").numpy().copy()


def test_a_position_is_the_default_plus_the_scaled_action(make: Make) -> None:
  env = acting(make, legs=mdp.JointPositionActionCfg(scale=0.5))
  action = actions(env, 0)
  np.testing.assert_allclose(targets(env, action), DEFAULT + 0.5 * action.double().numpy(), rtol=1e-12)
  assert env.action_manager.total_action_dim == 2
  term = env.action_manager.get_term("legs")
  assert isinstance(term, mdp.AffineAction)
  assert term.target_names == ["hip", "knee"]
  assert term.scale.shape == term.offset.shape == (1, 2)
  assert torch.equal(env.action_manager.action, action)


BY_PATTERN: dict[str, Any] = {"scale": {"hip": 2.0, "knee": 0.1}, "offset": {"hip": 0.3, "knee": -0.2}}


@pytest.mark.parametrize(
  ("options", "expected"),
  [
    ({"clip": (-0.1, 0.3)}, lambda a: (DEFAULT + a).clip(-0.1, 0.3)),
    (
      BY_PATTERN | {"use_default_offset": False, "clip": {"hip": (-0.5, 0.5)}},
      lambda a: (a * [2.0, 0.1] + [0.3, -0.2]).clip([-0.5, -np.inf], [0.5, np.inf]),
    ),
  ],
)
def test_scales_offsets_and_clips_are_for_all_joints_or_by_pattern(make: Make, options: Any, expected: Any) -> None:
  env = acting(make, legs=mdp.JointPositionActionCfg(**options))
  action = 10.0 * actions(env, 1)
  np.testing.assert_allclose(targets(env, action), expected(action.double().numpy()), rtol=1e-12)


@pytest.mark.parametrize(("preserve", "names"), [(True, ["knee", "hip"]), (False, ["hip", "knee"])])
def test_columns_come_in_the_order_of_the_model_or_of_the_patterns(
  make: Make, preserve: bool, names: list[str]
) -> None:
  cfg = mdp.JointPositionActionCfg(actuators=("knee", "hip"), preserve_order=preserve, scale={"hip": 1.0, "knee": 2.0})
  env = acting(make, legs=cfg)
  term = env.action_manager.get_term("legs")
  assert isinstance(term, mdp.AffineAction)
  assert term.target_names == names
  # The order is no state.
  assert "_ids" not in term.state_dict()
  action = actions(env, 3)
  by_name = dict(zip(names, action.double().numpy().T, strict=True))
  expected = np.stack([DEFAULT[0] + by_name["hip"], DEFAULT[1] + 2.0 * by_name["knee"]], axis=1)
  np.testing.assert_allclose(targets(env, action), expected, rtol=1e-12)


def test_the_bias_of_encoders_is_taken_off_positions(make: Make) -> None:
  env = acting(make, legs=mdp.JointPositionActionCfg())
  bias = torch.tensor([[0.01, -0.02], [0.0, 0.0], [0.05, 0.05], [-0.1, 0.1]], dtype=torch.float64)
  env.scene["robot"].data.encoder_bias.copy_(bias)
  action = actions(env, 4)
  np.testing.assert_allclose(targets(env, action), DEFAULT + action.double().numpy() - bias.numpy(), rtol=1e-12)


def test_velocities_and_efforts_have_separate_targets(make: Make) -> None:
  env = acting(
    make,
    hip=mdp.JointVelocityActionCfg(actuators="hip", scale=3.0),
    knee=mdp.JointEffortActionCfg(actuators="knee", scale=5.0, offset=1.0),
  )
  action = actions(env, 5)
  numbers = action.double().numpy()
  np.testing.assert_allclose(targets(env, action, "vel")[:, 0], 3.0 * numbers[:, 0], rtol=1e-12)
  np.testing.assert_allclose(targets(env, action, "effort")[:, 1], 5.0 * numbers[:, 1] + 1.0, rtol=1e-12)
  np.testing.assert_allclose(env.scene["robot"].data.joint_pos_target.numpy(), np.tile(DEFAULT, (4, 1)))
  assert env.action_manager.term_slices() == {"hip": slice(0, 1), "knee": slice(1, 2)}


def test_the_target_reaches_the_engine(make: Make) -> None:
  env = acting(make, legs=mdp.JointPositionActionCfg(scale=0.1))
  action = actions(env, 6)
  target = targets(env, action)
  np.testing.assert_allclose(env.sim.data.ctrl.numpy(), target, rtol=1e-12)
  for _ in range(40):
    env.episode_length_buf.zero_()
    env.step(action)
  # A stiff spring settles near its target; the rest is weight.
  assert np.abs(env.scene["robot"].data.joint_pos.numpy() - target).max() < 0.6


def test_differences_are_from_where_the_joints_are_and_fixed_for_the_whole_step(make: Make) -> None:
  env = acting(make, legs=mdp.RelativeJointPositionActionCfg(scale=0.1))
  bias = torch.tensor([0.02, -0.03], dtype=torch.float64)
  env.scene["robot"].data.encoder_bias.copy_(bias)
  for step in range(3):
    before = env.scene["robot"].data.joint_pos.numpy().copy()
    action = actions(env, step)
    # A bias moves what is read and what is asked for alike.
    np.testing.assert_allclose(targets(env, action), before + 0.1 * action.double().numpy(), atol=1e-12)
    assert np.abs(env.scene["robot"].data.joint_pos.numpy() - before).max() > 1e-4


def test_differences_from_the_last_target_add_up_within_the_clip_until_a_reset(make: Make) -> None:
  cfg = mdp.RelativeJointPositionActionCfg(relative_to="target", scale=0.1, clip={"hip": (-0.3, 0.3)})
  env = acting(make, legs=cfg)
  start = env.scene["robot"].data.joint_pos.numpy().copy()
  action = torch.ones(4, 2)
  for step in range(1, 4):
    expected = start + 0.1 * step
    expected[:, 0] = np.minimum(expected[:, 0], 0.3)
    np.testing.assert_allclose(targets(env, action), expected, atol=1e-7)
  env.reset(env_ids=[1])
  after = targets(env, action)
  np.testing.assert_allclose(after[1], start[1] + [0.1, 0.1], atol=1e-7)
  np.testing.assert_allclose(after[0], [0.3, start[0, 1] + 0.4], atol=1e-7)


def test_smoothed_targets_follow_the_average_from_where_an_episode_begins(make: Make) -> None:
  env = acting(make, legs=mdp.SmoothedJointPositionActionCfg(scale=0.5, smoothing=0.75, clip=(-1.0, 1.0)))
  start = env.scene["robot"].data.joint_pos.numpy().copy()
  expected = start
  for step in range(3):
    action = 2.0 * actions(env, step)
    expected = 0.75 * expected + 0.25 * (DEFAULT + 0.5 * action.double().numpy()).clip(-1.0, 1.0)
    np.testing.assert_allclose(targets(env, action), expected, rtol=1e-12)
  env.reset(env_ids=[2])
  action = torch.zeros(4, 2)
  expected = 0.75 * expected + 0.25 * DEFAULT
  expected[2] = 0.75 * start[2] + 0.25 * DEFAULT
  np.testing.assert_allclose(targets(env, action), expected, rtol=1e-12)


def test_a_binary_action_opens_for_zero_or_more_and_closes_below(make: Make) -> None:
  cfg = mdp.BinaryJointPositionActionCfg(open={"hip": 0.5, "knee": 0.2}, close={".*": -0.1}, clip={"hip": (-1.0, 0.4)})
  env = acting(make, grip=cfg)
  assert env.action_manager.total_action_dim == 1
  bias = torch.tensor([0.02, -0.03], dtype=torch.float64)
  env.scene["robot"].data.encoder_bias.copy_(bias)
  closed, opened = np.array([-0.1, -0.1]) - bias.numpy(), np.array([0.4, 0.2]) - bias.numpy()
  got = targets(env, torch.tensor([[-1e-3], [0.0], [5.0], [-7.0]]))
  np.testing.assert_allclose(got, [closed, opened, opened, closed], rtol=1e-12)


@pytest.mark.parametrize(
  ("cfg", "message"),
  [
    ({"legs": mdp.SmoothedJointPositionActionCfg(smoothing=1.0)}, r"smoothing must be in \[0, 1\), got 1.0"),
    (
      {"legs": mdp.RelativeJointPositionActionCfg(relative_to="goal")},  # pyright: ignore[reportArgumentType]  # ty: ignore[invalid-argument-type]
      "relative_to 'goal' does not exist",
    ),
    ({"grip": mdp.BinaryJointPositionActionCfg(open={"hip": 1.0}, close={".*": 0.0})}, "open.*joint knee"),
    ({"legs": mdp.JointPositionActionCfg(offset=5.0)}, "offset requires use_default_offset=False"),
    ({"legs": mdp.JointVelocityActionCfg(offset=5.0)}, "offset requires use_default_offset=False; got offset=5.0"),
    ({"legs": mdp.JointPositionActionCfg(clip=(1.0, -1.0))}, "clip"),
    ({"legs": mdp.JointPositionActionCfg(clip={"hip": (1.0, -1.0)})}, "clip must not fall"),
    ({"legs": mdp.JointPositionActionCfg(scale=float("nan"))}, "scale must be a number, got nan"),
    ({"legs": mdp.JointPositionActionCfg(actuators="hop")}, "'hop' matches no actuated joint. Nearest: hip"),
    ({"legs": mdp.JointPositionActionCfg(scale={"hip": 1.0})}, "knee"),
    ({"legs": mdp.JointPositionActionCfg(scale={"hip": 1.0, "knee": 1.0, "toe": 2.0})}, "toe"),
    ({"legs": mdp.JointPositionActionCfg(entity="dog")}, "dog"),
    (
      {"a": mdp.JointPositionActionCfg(actuators="hip"), "b": mdp.JointEffortActionCfg(actuators=".*")},
      "terms 'a' and 'b' both drive robot/hip",
    ),
  ],
  ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_mistake_in_an_action_is_named_at_build(make: Make, cfg: dict, message: str) -> None:
  with pytest.raises(ConfigError, match=message):
    make(hopper_cfg(actions=cfg))
