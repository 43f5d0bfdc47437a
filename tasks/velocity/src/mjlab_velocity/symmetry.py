"""Mirror images of observations and actions of velocity tasks, for robots with equal left and right sides.

The plane of the mirror is the robot's own, between left and right. Vectors keep x and z; axes of rotation keep y. The
Go1 measures linear velocities 7 cm beside this plane, so their mirror image is only right where it does not turn.
"""

import math
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import torch
from mjlab_core import ConfigError

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

Mirror = tuple[list[int], list[float]]
"""Columns and signs, as `mjlab_rl.offpolicy.replay` takes them."""

_VECTOR, _ROTATION = (1.0, -1.0, 1.0), (-1.0, 1.0, -1.0)
_TWINS = {"left": "right", "right": "left", "FL": "FR", "FR": "FL", "RL": "RR", "RR": "RL"}


def twin(name: str) -> str:
  """Return the name of the part on the other side; parts in the middle are their own."""
  return re.sub(r"(?<![A-Za-z])(left|right|F[LR]|R[LR])(?![A-Za-z])", lambda side: _TWINS[side[1]], name)


def left_right(env: "ManagerBasedRlEnv") -> dict[str, Mirror]:
  """Return the mirror of each observation group, and of the "action", of a velocity task.

  Raises:
    ConfigError: The mirror image of a term is not known; the message names it.
  """
  action: Any = env.action_manager.get_term("joint_pos")
  joints, actions = (_joints(env, names) for names in (env.scene["robot"].joint_names, action.target_names))
  sensors: dict[str, Any] = env.cfg.scene.sensors
  scanned, touched = sensors["foot_height_scan"].frames.pattern, sensors["feet_ground_contact"].primary.pattern
  known: dict[str, Mirror] = {
    "base_lin_vel": _signed(_VECTOR),
    "projected_gravity": _signed(_VECTOR),
    "base_ang_vel": _signed(_ROTATION),
    "command": _signed((1.0, -1.0, -1.0)),
    "joint_pos": joints,
    "joint_vel": joints,
    "actions": actions,
    "foot_height": _swapped(scanned, (1.0,)),
    "foot_air_time": _swapped(touched, (1.0,)),
    "foot_contact": _swapped(touched, (1.0,)),
    "foot_contact_forces": _swapped(touched, _VECTOR),
  }
  if "terrain_scan" in sensors:
    known["height_scan"] = _grid(torch.as_tensor(sensors["terrain_scan"].pattern.rays()[0]))
  mirrors: dict[str, Mirror] = {"action": actions}
  for group in env.observation_manager.active_groups:
    columns: list[int] = []
    signs: list[float] = []
    for term in env.observation_manager.layout(group):
      if term.name not in known:
        raise ConfigError(f"symmetry: the mirror image of observation '{group}/{term.name}' is not known")
      one, flips = known[term.name]
      width = term.columns.stop - term.columns.start
      if width % len(one):
        raise ConfigError(f"symmetry: observation '{group}/{term.name}' has {width} columns, not {len(one)}")
      # A history is the term several times.
      for start in range(term.columns.start, term.columns.stop, len(one)):
        columns += [start + column for column in one]
        signs += flips
    mirrors[group] = (columns, signs)
  return mirrors


def _signed(signs: Sequence[float]) -> Mirror:
  return list(range(len(signs))), list(signs)


def _swapped(parts: Sequence[str], signs: Sequence[float]) -> Mirror:
  """Return the mirror of `len(signs)` numbers of each part, in the order of the parts."""
  others, width = [parts.index(twin(part)) for part in parts], len(signs)
  return [other * width + i for other in others for i in range(width)], [*signs] * len(parts)


def _grid(points: torch.Tensor) -> Mirror:
  """Return the mirror of one number for each point, (n, 3), of a pattern that reaches as far to either side."""
  images = points * points.new_tensor((1.0, -1.0, 1.0))
  return torch.cdist(images, points).argmin(1).tolist(), [1.0] * len(points)


def _joints(env: "ManagerBasedRlEnv", names: Sequence[str]) -> Mirror:
  """Return the mirror of one number for each joint: a joint turns like its twin, or the other way round."""
  model = env.sim.mj_model
  columns, signs = [], []
  for name in names:
    mine, other = (model.joint(f"robot/{joint}").axis for joint in (name, twin(name)))
    columns.append(list(names).index(twin(name)))
    signs.append(math.copysign(1.0, (mine * other) @ _ROTATION))
  return columns, signs
