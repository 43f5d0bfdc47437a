"""Observations of lifting tasks. `hand` selects one site."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, cast

import torch
from mjlab_core import matrix_from_quat, quat_apply_inverse, quat_conjugate, quat_mul, subtract_frames
from mjlab_envs.mdp.readings import pose_of
from mjlab_managers import Reading, SceneEntityCfg, TermSource, sourced

from mjlab_manipulation.mdp.stages import lift_command

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv


# Sources, for the export of policies: poses in the frame of the robot's root. A robot knows its hand from its joints.


def _hand_to_object(env: "ManagerBasedRlEnv", *, command: str, hand: SceneEntityCfg) -> TermSource:
  place, _ = _hand(env, hand)
  return TermSource(readings=(place, _object(env, command)[0]), compute=lambda of_hand, of_object: of_object - of_hand)


def _object_to_goal(env: "ManagerBasedRlEnv", *, command: str) -> TermSource:
  return TermSource(
    readings=(_object(env, command)[0], _goal(env, command)), compute=lambda of_object, goal: goal - of_object
  )


def _object_size(env: "ManagerBasedRlEnv", *, command: str) -> TermSource:
  term = lift_command(env, command)
  return TermSource(readings=(Reading(name="perception/object/size", read=lambda: term.object_size, unit="m"),))


def _object_in_hand(env: "ManagerBasedRlEnv", *, command: str, hand: SceneEntityCfg) -> TermSource:
  def compute(hand_quat: torch.Tensor, quat: torch.Tensor) -> torch.Tensor:
    return _two_axes(quat_mul(quat_conjugate(hand_quat), quat))

  return TermSource(readings=(_hand(env, hand)[1], _object(env, command)[1]), compute=compute)


def _goal_in_hand(env: "ManagerBasedRlEnv", *, command: str, hand: SceneEntityCfg) -> TermSource:
  return TermSource(
    readings=(*_hand(env, hand), _goal(env, command)),
    compute=lambda place, quat, goal: quat_apply_inverse(quat, goal - place),
  )


def _hand(env: "ManagerBasedRlEnv", hand: SceneEntityCfg) -> tuple[Reading, Reading]:
  data, entity, ids = env.scene[hand.name].data, env.scene[hand.name], hand.site_ids
  site = cast("tuple[str, ...]", hand.site_names)[0]
  return _in_root(
    env,
    f"hand/{site}",
    lambda: (data.site_pos_w[:, ids].squeeze(1), data.site_quat_w[:, ids].squeeze(1)),
    ("site", entity.prefix + site),
  )


def _object(env: "ManagerBasedRlEnv", command: str) -> tuple[Reading, Reading]:
  term = lift_command(env, command)
  entity = env.scene[term.cfg.objects[0]]
  of = ("body", entity.prefix + entity.root_body_name) if len(term.cfg.objects) == 1 else None
  return _in_root(env, "perception/object", lambda: (term.object_pos_w, term.object_quat_w), of)


def _goal(env: "ManagerBasedRlEnv", command: str) -> Reading:
  term, data = lift_command(env, command), env.scene["robot"].data
  return Reading(
    name="command/goal",
    read=lambda: quat_apply_inverse(data.root_link_quat_w, term.goal_pos_w - data.root_link_pos_w),
    unit="m",
    frame=env.scene["robot"].root_body_name,
    columns=("x", "y", "z"),
  )


def _in_root(
  env: "ManagerBasedRlEnv",
  name: str,
  pose: Callable[[], tuple[torch.Tensor, torch.Tensor]],
  of: tuple[str, str] | None,
) -> tuple[Reading, Reading]:
  """Return the readings of a pose in the frame of the robot's root."""
  robot = env.scene["robot"]

  def read(part: int) -> torch.Tensor:
    return subtract_frames(robot.data.root_link_pos_w, robot.data.root_link_quat_w, *pose())[part]

  root = robot.prefix + robot.root_body_name
  parts = (("position", partial(read, 0)), ("orientation", partial(read, 1)))
  if of is None:
    first, second = (Reading(name=f"{name}/{quantity}", read=reader) for quantity, reader in parts)
  else:
    first, second = (
      pose_of(f"{name}/{quantity}", reader, quantity=quantity, of=of, frame=root) for quantity, reader in parts
    )
  return first, second


@sourced(_hand_to_object)
def hand_to_object(env: "ManagerBasedRlEnv", *, command: str, hand: SceneEntityCfg) -> torch.Tensor:
  """Return the vector from the hand to the centre of the object, in the robot's root frame, (num_envs, 3) [m]."""
  data = env.scene[hand.name].data
  way = lift_command(env, command).object_pos_w - data.site_pos_w[:, hand.site_ids].squeeze(1)
  return quat_apply_inverse(data.root_link_quat_w, way)


@sourced(_object_to_goal)
def object_to_goal(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Return the vector from the centre of the object to its goal, in the robot's root frame, (num_envs, 3) [m]."""
  term = lift_command(env, command)
  return quat_apply_inverse(env.scene["robot"].data.root_link_quat_w, term.goal_pos_w - term.object_pos_w)


@sourced(_object_size)
def object_size(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Return the edges of the object's bounding box, in the frame of its body, (num_envs, 3) [m]."""
  return lift_command(env, command).object_size


@sourced(_object_in_hand)
def object_in_hand(env: "ManagerBasedRlEnv", *, command: str, hand: SceneEntityCfg) -> torch.Tensor:
  """Return the first two axes of the object in the frame of the hand, (num_envs, 6)."""
  quat = env.scene[hand.name].data.site_quat_w[:, hand.site_ids].squeeze(1)
  turn = quat_mul(quat_conjugate(quat), lift_command(env, command).object_quat_w)
  return _two_axes(turn)


@sourced(_goal_in_hand)
def goal_in_hand(env: "ManagerBasedRlEnv", *, command: str, hand: SceneEntityCfg) -> torch.Tensor:
  """Return the goal in the frame of the hand, (num_envs, 3) [m]."""
  data = env.scene[hand.name].data
  place, quat = (value[:, hand.site_ids].squeeze(1) for value in (data.site_pos_w, data.site_quat_w))
  return quat_apply_inverse(quat, lift_command(env, command).goal_pos_w - place)


def _two_axes(quat: torch.Tensor) -> torch.Tensor:
  return matrix_from_quat(quat)[..., :2].mT.flatten(1)
