"""Observations of lifting tasks. `hand` selects one site."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar, cast

import torch
from mjlab_core import matrix_from_quat, quat_apply_inverse, quat_conjugate, quat_mul, subtract_frames
from mjlab_envs.mdp.readings import pose_of
from mjlab_managers import Reading, SceneEntityCfg, TermSource, sourced

from mjlab_manipulation.mdp.stages import hand_pos, lift_command

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

T = TypeVar("T", bound=Callable[..., Any])


def _computed_from(*names: str, compute: Callable[..., torch.Tensor] | None = None) -> Callable[[T], T]:
  """Declare the `_readings` of an observation by name, and its computation from them, for the export of policies."""

  def describe(env: "ManagerBasedRlEnv", *, command: str, hand: SceneEntityCfg | None = None) -> TermSource:
    readings = _readings(env, command, hand)
    return TermSource(readings=tuple(readings[name] for name in names), compute=compute)

  return sourced(describe)


def _readings(env: "ManagerBasedRlEnv", command: str, hand: SceneEntityCfg | None) -> dict[str, Reading]:
  """Return readings in the frame of the robot's root by name. A robot knows its hand from its joints."""
  term, robot = lift_command(env, command), env.scene["robot"]
  readings = {
    "size": Reading(name="perception/object/size", read=lambda: term.object_size, unit="m"),
    "goal": Reading(
      name="command/goal",
      read=lambda: quat_apply_inverse(robot.data.root_link_quat_w, term.goal_pos_w - robot.data.root_link_pos_w),
      unit="m",
      frame=robot.root_body_name,
      columns=("x", "y", "z"),
    ),
  }

  def add_pose(name: str, of: tuple[str, str], read: Callable[[], tuple[torch.Tensor, torch.Tensor]]) -> None:
    def in_root(part: int) -> torch.Tensor:
      return subtract_frames(robot.data.root_link_pos_w, robot.data.root_link_quat_w, *read())[part]

    for part, quantity in enumerate(("position", "orientation")):
      reading = pose_of(f"{name}/{quantity}", partial(in_root, part), quantity=quantity, of=of, frame=_body(robot))
      readings[f"{of[0]} {quantity}"] = reading

  add_pose(
    "perception/object",
    ("body", _body(env.scene[term.cfg.objects[0]])),
    lambda: (term.object_pos_w, term.object_quat_w),
  )
  if len(term.cfg.objects) > 1:
    # The object differs between worlds, so it has no place in the model.
    readings = {name: replace(reading, origin=None) for name, reading in readings.items()}
  if hand is not None:
    (site,) = cast("tuple[str, ...]", hand.site_names)
    add_pose(
      f"hand/{site}",
      ("site", env.scene[hand.name].prefix + site),
      lambda: (hand_pos(env, hand), _hand_quat(env, hand)),
    )
  return readings


def _body(entity: Any) -> str:
  """Return the name of an entity's root body in the model."""
  return entity.prefix + entity.root_body_name


def _hand_quat(env: "ManagerBasedRlEnv", hand: SceneEntityCfg) -> torch.Tensor:
  """Return the orientation of the hand, world frame, (num_envs, 4)."""
  return env.scene[hand.name].data.site_quat_w[:, hand.site_ids].squeeze(1)


def _seen_from(place: torch.Tensor, quat: torch.Tensor, point: torch.Tensor) -> torch.Tensor:
  return quat_apply_inverse(quat, point - place)


def _two_axes(hand_quat: torch.Tensor, quat: torch.Tensor) -> torch.Tensor:
  return matrix_from_quat(quat_mul(quat_conjugate(hand_quat), quat))[..., :2].mT.flatten(1)


@_computed_from("site position", "body position", compute=lambda hand, of_object: of_object - hand)
def hand_to_object(env: "ManagerBasedRlEnv", *, command: str, hand: SceneEntityCfg) -> torch.Tensor:
  """Return the vector from the hand to the centre of the object, in the robot's root frame, (num_envs, 3) [m]."""
  way = lift_command(env, command).object_pos_w - hand_pos(env, hand)
  return quat_apply_inverse(env.scene[hand.name].data.root_link_quat_w, way)


@_computed_from("body position", "goal", compute=lambda of_object, goal: goal - of_object)
def object_to_goal(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Return the vector from the centre of the object to its goal, in the robot's root frame, (num_envs, 3) [m]."""
  term = lift_command(env, command)
  return quat_apply_inverse(env.scene["robot"].data.root_link_quat_w, term.goal_pos_w - term.object_pos_w)


@_computed_from("size")
def object_size(env: "ManagerBasedRlEnv", *, command: str) -> torch.Tensor:
  """Return the edges of the object's bounding box, in the frame of its body, (num_envs, 3) [m]."""
  return lift_command(env, command).object_size


@_computed_from("site orientation", "body orientation", compute=_two_axes)
def object_in_hand(env: "ManagerBasedRlEnv", *, command: str, hand: SceneEntityCfg) -> torch.Tensor:
  """Return the first two axes of the object in the frame of the hand, (num_envs, 6)."""
  return _two_axes(_hand_quat(env, hand), lift_command(env, command).object_quat_w)


@_computed_from("site position", "site orientation", "goal", compute=_seen_from)
def goal_in_hand(env: "ManagerBasedRlEnv", *, command: str, hand: SceneEntityCfg) -> torch.Tensor:
  """Return the goal in the frame of the hand, (num_envs, 3) [m]."""
  return _seen_from(hand_pos(env, hand), _hand_quat(env, hand), lift_command(env, command).goal_pos_w)
