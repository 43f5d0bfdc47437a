"""Mirror images of robots: a mirrored state gives the mirrored observation, before and after a mirrored action."""

from typing import Any, cast

import pytest
import torch
from mjlab_core.errors import ConfigError
from mjlab_envs import ManagerBasedRlEnv
from mjlab_rl import OffPolicyRunnerCfg
from mjlab_rl.offpolicy.algorithm import action_bounds
from mjlab_velocity import g1_flat, g1_flat_blind, g1_flat_env, g1_rough, g1_rough_blind, g1_rough_env, go1_flat_env
from mjlab_velocity.symmetry import left_right, twin


def quiet(cfg: Any) -> Any:
  """Two worlds without noise, randomisation and random commands."""
  cfg.scene.num_envs, cfg.seed = 2, 0
  cfg.events, cfg.curriculum = {}, {}
  for group in cfg.observations.values():
    group.corrupt = False
  return cfg


def test_twins_are_on_the_other_side() -> None:
  assert twin("left_hip_pitch_joint") == "right_hip_pitch_joint"
  assert twin("FR_calf_joint") == "FL_calf_joint"
  assert twin("waist_yaw_joint") == "waist_yaw_joint"


@pytest.mark.parametrize("robot", [g1_flat_env, go1_flat_env])
def test_a_mirrored_state_and_action_give_mirrored_observations(robot: Any) -> None:
  torch.manual_seed(0)
  with ManagerBasedRlEnv(quiet(robot()), device="cpu") as env:
    env.reset()
    mirrors = {name: (torch.tensor(columns), torch.tensor(signs)) for name, (columns, signs) in left_right(env).items()}

    def image(name: str, value: torch.Tensor) -> torch.Tensor:
      columns, signs = mirrors[name]
      return value[..., columns] * signs.to(value.dtype)

    entity = env.scene["robot"]
    joints, _ = left_right(env)["action"]
    signs = torch.tensor(left_right(env)["action"][1], dtype=env.sim.dtype)
    data = env.sim.data
    # World 1 is the mirror image of world 0.
    offset = 0.15 * torch.randn(len(joints), dtype=env.sim.dtype)
    speed = 0.5 * torch.randn(len(joints), dtype=env.sim.dtype)
    root_speed = 0.3 * torch.randn(6, dtype=env.sim.dtype)
    names, order = entity.joint_names, [f"robot/{name}" for name in entity.joint_names]
    model = env.sim.mj_model
    q = [int(model.joint(name).qposadr[0]) for name in order]
    v = [int(model.joint(name).dofadr[0]) for name in order]
    action_term: Any = env.action_manager.get_term("joint_pos")
    assert list(names) == list(action_term.target_names)
    data.qpos[0, q] += offset
    data.qpos[1, q] += offset[joints] * signs
    data.qpos[0, 2] += 0.1
    data.qpos[1, 2] += 0.1
    data.qpos[1, 1] = -data.qpos[0, 1]
    tilt = torch.tensor([0.98, 0.1, -0.12, 0.07], dtype=env.sim.dtype)
    tilt /= tilt.norm()
    data.qpos[0, 3:7] = tilt
    data.qpos[1, 3:7] = tilt * torch.tensor([1, -1, 1, -1], dtype=env.sim.dtype)
    data.qvel[0, v] = speed
    data.qvel[1, v] = speed[joints] * signs
    data.qvel[0, :6] = root_speed
    data.qvel[1, :6] = root_speed * torch.tensor([1, -1, 1, -1, 1, -1], dtype=env.sim.dtype)
    env.sim.forward()
    action = 0.3 * torch.randn(1, len(joints))
    actions = torch.cat((action, image("action", action)))
    env.command_manager.get_command("twist")[:] = torch.tensor([[0.5, 0.2, 0.3], [0.5, -0.2, -0.3]])
    for _ in range(3):
      observed: dict[str, Any] = dict(env.step(actions)[0])
      for group in ("actor", "critic"):
        keep = torch.ones(observed[group].shape[1], dtype=torch.bool)
        for term in env.observation_manager.layout(group):
          # Commands are drawn for each world, and the Go1 measures velocities 7 cm beside its middle.
          keep[term.columns] = term.name != "command" and (robot is g1_flat_env or term.name != "base_lin_vel")
        found, expected = observed[group][1], image(group, observed[group][0])
        torch.testing.assert_close(found[keep], expected[keep], atol=0.02, rtol=0.02)


def test_a_scan_is_mirrored_point_by_point() -> None:
  cfg = quiet(g1_rough_env())
  points = torch.as_tensor(cfg.scene.sensors["terrain_scan"].pattern.rays()[0])
  with ManagerBasedRlEnv(cfg, device="cpu") as env:
    mirrors = left_right(env)
    for group in ("actor", "critic"):
      (scan,) = (term for term in env.observation_manager.layout(group) if term.name == "height_scan")
      columns = torch.tensor(mirrors[group][0])[scan.columns] - scan.columns.start
      torch.testing.assert_close(points[columns], points * torch.tensor([1.0, -1.0, 1.0]))
      assert set(mirrors[group][1][scan.columns]) == {1.0}


def test_a_term_without_a_mirror_image_is_named() -> None:
  cfg = quiet(g1_flat_env())
  cfg.observations["actor"].terms["speed"] = cfg.observations["actor"].terms["base_lin_vel"]
  with ManagerBasedRlEnv(cfg, device="cpu") as env, pytest.raises(ConfigError, match=r"'actor/speed' is not known"):
    left_right(env)


@pytest.mark.parametrize("task", [g1_flat, g1_rough, g1_flat_blind, g1_rough_blind])
def test_fastsac_of_the_g1_learns_from_mirror_images_and_three_rewards(task: Any) -> None:
  agent = cast("OffPolicyRunnerCfg", task().agents["fastsac"])
  assert agent.algorithm.symmetry is left_right
  assert agent.algorithm.n_step == 3
  assert agent.experiment_name.removesuffix("_fastsac") == task().agent.experiment_name


def test_actions_of_fastsac_reach_the_farther_limits_of_joints() -> None:
  agent = cast("OffPolicyRunnerCfg", g1_flat().agents["fastsac"])
  with ManagerBasedRlEnv(quiet(g1_flat_env()), device="cpu") as env:
    term: Any = env.action_manager.get_term("joint_pos")
    bounds = action_bounds(env, env.action_manager.total_action_dim, agent.algorithm)[0]
    joints = [env.sim.mj_model.joint(f"robot/{name}") for name in term.target_names]
    ranges = torch.tensor([joint.range.tolist() for joint in joints])
    default = env.scene["robot"].data.default_joint_pos[0, env.scene["robot"].find_joints(term.target_names)[0]]
    farther = (ranges - default[:, None]).abs().amax(1)
    assert all(joint.range[0] < joint.range[1] for joint in joints)
    torch.testing.assert_close(bounds * term.scale[0], farther.to(bounds), atol=1e-5, rtol=1e-5, check_dtype=False)
