"""Options of the velocity command that no task of this package uses."""

from typing import Any

import torch
from mjlab_envs import ManagerBasedRlEnv
from mjlab_envs.mdp import reset_scene_to_default
from mjlab_managers import EventTermCfg
from mjlab_velocity.mdp import UniformVelocityCommandCfg
from velocity_rollout import make_env


def env_with(num_envs: int, **options: Any) -> tuple[ManagerBasedRlEnv, Any]:
  commands = {"twist": UniformVelocityCommandCfg(**options)}
  env = make_env(
    num_envs, commands=commands, curriculum={}, events={"reset": EventTermCfg(reset_scene_to_default, mode="reset")}
  )
  env.reset()
  return env, env.command_manager.get_term("twist")


def turn(env: ManagerBasedRlEnv, yaw: float) -> None:
  quat = env.sim.data.qpos[:, 3:7]
  quat.zero_()
  quat[:, 0], quat[:, 3] = torch.cos(torch.tensor(yaw / 2)), torch.sin(torch.tensor(yaw / 2))
  env.command_manager.compute(0.0, torch.ones(env.num_envs, dtype=torch.bool))


def test_a_velocity_along_the_axes_of_the_world_turns_against_the_root() -> None:
  env, term = env_with(64, world_fraction=0.5, standing_fraction=0.0, heading_fraction=0.0, forward_fraction=0.0)
  turn(env, 0.0)
  before = term.command.clone()
  turn(env, torch.pi / 2)
  x, y, spin = before.unbind(-1)
  # A quarter turn to the left sees what was ahead on its right.
  turned = torch.stack((y, -x, spin), -1)
  in_world = (term.command - turned).abs().amax(-1) < 1e-6
  in_root = (term.command == before).all(-1)
  assert (in_world ^ in_root).all()
  assert 20 < in_world.sum() < 44


def test_a_share_of_episodes_begins_at_the_drawn_velocity_and_later_draws_push_no_robot() -> None:
  env, term = env_with(64, initial_velocity_fraction=0.5, heading_fraction=0.0)
  velocity = torch.cat((env.scene["robot"].data.root_link_lin_vel_b, env.scene["robot"].data.root_link_ang_vel_b), -1)
  wanted = torch.cat((term.command[:, :2], torch.zeros(64, 3), term.command[:, 2:]), -1).to(velocity.dtype)
  moves = wanted.abs().sum(-1) > 0
  at_speed = (velocity - wanted).abs().amax(-1) < 1e-5
  at_rest = velocity.abs().amax(-1) == 0
  assert (at_speed | at_rest).all()
  assert 15 < (at_speed & moves).sum() < 45
  before = env.sim.data.qvel.clone()
  term.time_left.zero_()
  env.command_manager.compute(env.step_dt)
  assert (term.command_counter == 2).all()
  assert torch.equal(env.sim.data.qvel, before)
