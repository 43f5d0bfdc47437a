"""Lift command: the object to lift, its goal, and the time for it."""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any

import torch
from mjlab_core import DebugDraw, Limits, MjlabError, NonNegative, Range, check_fields, check_value, where_
from mjlab_managers import CommandTerm, CommandTermCfg

from mjlab_manipulation.mdp.extent import Extent

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv


@dataclass(kw_only=True)
class Region:
  """Box relative to the origin of each world [m]."""

  x: Range
  y: Range
  z: Range


@dataclass(kw_only=True)
class LiftCommandCfg(CommandTermCfg):
  """Lift command: each reset draws the object to lift, its goal, the time for it, and the start of all objects.

  A goal lasts for the episode, which the termination `goal_over` ends.

  Objects stand in a row along y, in a random order, with at least `min_distance` between centres. The draw is uniform
  over all such rows, without rejection. If objects are enlarged after the build, their distances grow with them, if
  necessary beyond the ends of `start`.
  """

  resampling_time_range: tuple[float, float] | None = None
  debug_vis: bool = True
  objects: tuple[str, ...] = ("cube",)
  """Entities that can be lifted; each world lifts one of them."""
  goal: Region = field(default_factory=lambda: Region(x=(0.3, 0.5), y=(-0.2, 0.2), z=(0.2, 0.4)))
  """Goals of the object's centre."""
  start: Region = field(default_factory=lambda: Region(x=(0.22, 0.4), y=(-0.103, 0.103), z=(0.0, 0.03)))
  """Start of objects: x and y of origins, z of lowest points. With the default, the wrist camera sees all of a cube of
  4 cm from the pose "home"."""
  start_yaw: Range = (-math.pi, math.pi)
  """Yaw of objects at the start [rad]."""
  min_distance: NonNegative = 0.06
  """Least distance between the origins of two objects along y [m]; it must keep them apart for every yaw."""
  goal_time_range: Range = (8.0, 12.0)
  """Time for a goal [s]."""

  def build(self, env: Any) -> "LiftCommand":
    return LiftCommand(self, env)


class LiftCommand(CommandTerm):
  """Lift command of `LiftCommandCfg`.

  Raises:
    MjlabError: There is no object; an object does not exist, has a fixed base or has no extent; a range is inverted;
      or the objects do not fit into `start`.
  """

  cfg: LiftCommandCfg

  def __init__(self, cfg: LiftCommandCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    check_fields(cfg, "LiftCommandCfg")
    for name, region in (("goal", cfg.goal), ("start", cfg.start)):
      check_fields(region, name)
    if cfg.resampling_time_range is not None:
      raise MjlabError("resampling_time_range must be None: resets draw the command; goal_time_range sets its time")
    self._objects = [env.scene[name] for name in cfg.objects]
    for name, entity in zip(cfg.objects, self._objects, strict=True):
      if entity.is_fixed_base:
        raise MjlabError(f"entity '{name}' cannot be lifted: its base is fixed")
    check_value("goal_time_range", cfg.goal_time_range, Annotated[Range, Limits(ge=env.step_dt)])
    count = len(self._objects)
    width = cfg.start.y[1] - cfg.start.y[0]
    if width < (count - 1) * cfg.min_distance:
      raise MjlabError(f"start.y is {width:g} m wide, too little for {count} objects {cfg.min_distance:g} m apart")
    self._extents = [Extent(env, entity) for entity in self._objects]
    if count > 1 and cfg.min_distance < (needed := float(self._apart().max())):
      raise MjlabError(f"min_distance is {cfg.min_distance:g} m, but objects may touch below {needed:.4g} m")
    self._goal = self.state((3,), dtype=env.sim.dtype)
    self.target = self.state(dtype=torch.int64)
    """Index of the object to lift, (num_envs,)."""
    self.goal_time = self.state(dtype=torch.float64)
    """Time from the reset to the end of the goal, (num_envs,) [s]."""

  @property
  def command(self) -> torch.Tensor:
    """Goal of the object's centre relative to the origin of its world, (num_envs, 3) [m]."""
    return self._goal

  @property
  def goal_pos_w(self) -> torch.Tensor:
    """Goal of the object's centre, world frame, (num_envs, 3) [m]."""
    return self._goal + self.env.scene.env_origins

  @property
  def object_pos_w(self) -> torch.Tensor:
    """Centre of the object to lift, world frame, (num_envs, 3) [m]."""
    return self._of_target([entity.data.root_link_pos_w for entity in self._objects])

  @property
  def object_quat_w(self) -> torch.Tensor:
    """Orientation of the object to lift, world frame, (num_envs, 4)."""
    return self._of_target([entity.data.root_link_quat_w for entity in self._objects])

  @property
  def object_height(self) -> torch.Tensor:
    """Height of the object's centre above the origin of its world, (num_envs,) [m]."""
    return self.object_pos_w[:, 2] - self.env.scene.env_origins[:, 2]

  @property
  def object_clearance(self) -> torch.Tensor:
    """Height of the object's lowest point above the origin of its world, (num_envs,) [m]."""
    return self._of_target([extent.lowest() for extent in self._extents]) - self.env.scene.env_origins[:, 2]

  @property
  def object_size(self) -> torch.Tensor:
    """Edges of the object's bounding box, in the frame of its body, (num_envs, 3) [m]."""
    boxes = [extent.box() for extent in self._extents]
    return self._of_target([(high - low).expand(self.num_envs, 3) for low, high in boxes])

  @property
  def distance(self) -> torch.Tensor:
    """Distance of the object's centre from the goal, (num_envs,) [m]."""
    return torch.linalg.vector_norm(self.goal_pos_w - self.object_pos_w, dim=-1)

  def of_target(self, values: torch.Tensor) -> torch.Tensor:
    """Return the value of the object to lift, (num_envs, ...), among those of all objects (num_envs, objects, ...)."""
    if values.shape[1] == 1:
      return values[:, 0]
    index = self.target.view(-1, 1, *[1] * (values.dim() - 2)).expand(-1, 1, *values.shape[2:])
    return values.gather(1, index)[:, 0]

  def _of_target(self, values: list[torch.Tensor]) -> torch.Tensor:
    return values[0] if len(values) == 1 else self.of_target(torch.stack(values, dim=1))

  def resample(self, mask: torch.Tensor) -> None:
    cfg, n, count = self.cfg, self.num_envs, len(self._objects)
    origins = self.env.scene.env_origins.to(self._goal.dtype)
    u = torch.rand(n, 5 * count + 5, generator=self.env.rng, device=self.device, dtype=self._goal.dtype)
    place, rest = u[:, : 5 * count].unflatten(1, (5, count)), u[:, 5 * count :]
    where_(self._goal, mask, torch.stack([_between(rest[:, i], getattr(cfg.goal, "xyz"[i])) for i in range(3)], 1))
    where_(self.target, mask, (rest[:, 3] * count).long().clamp(max=count - 1))
    where_(self.goal_time, mask, _between(rest[:, 4].double(), cfg.goal_time_range))

    below = torch.stack([extent.box()[0][:, 2].expand(n) for extent in self._extents], dim=1)
    x, z, yaw = (
      _between(place[:, 0], cfg.start.x),
      _between(place[:, 2], cfg.start.z) - below,
      _between(place[:, 3], cfg.start_yaw),
    )
    y = self._in_a_row(place[:, 1], place[:, 4])
    zero = torch.zeros_like(yaw)
    quat = torch.stack([torch.cos(0.5 * yaw), zero, zero, torch.sin(0.5 * yaw)], dim=-1)
    state = torch.cat(
      [torch.stack([x, y, z], dim=-1) + origins[:, None], quat, zero[..., None].expand(-1, -1, 6)], dim=-1
    )
    for i, entity in enumerate(self._objects):
      entity.write_root_state(state[:, i], mask)

  def _in_a_row(self, place: torch.Tensor, order: torch.Tensor) -> torch.Tensor:
    """Return y of objects [m] for uniform numbers that set places and order, (num_envs, objects) each."""
    cfg, count = self.cfg, len(self._objects)
    if count == 1:
      return _between(place, cfg.start.y)
    distance = self._apart().clamp(min=cfg.min_distance)
    slack = cfg.start.y[1] - cfg.start.y[0] - (count - 1) * distance
    row = cfg.start.y[0] + 0.5 * slack.clamp(max=0.0) + torch.arange(count, device=self.device) * distance
    y = row + place.sort(dim=1).values * slack.clamp(min=0.0)
    return y.gather(1, order.argsort(dim=1))

  def _apart(self) -> torch.Tensor:
    """Return the distance at which no two objects can touch, for their present sizes, (num_envs or 1, 1) [m]."""
    boxes = [extent.box() for extent in self._extents]
    reach = torch.stack(torch.broadcast_tensors(*(torch.maximum(-low, high)[:, :2] for low, high in boxes)), dim=1)
    return torch.linalg.vector_norm(reach, dim=-1).sort(dim=1).values[:, -2:].sum(1, keepdim=True)

  def reset(self, mask: torch.Tensor) -> None:
    """Leave all state to `resample`, which draws it."""

  def update(self) -> None:
    if self.by_hand is not None:
      where_(self._goal, *self.by_hand)

  # In viewers

  @property
  def axes(self) -> list[tuple[str, float, float]]:
    """Name, least and greatest value of each component of the goal."""
    goal = self.cfg.goal
    return [("goal x [m]", *goal.x), ("goal y [m]", *goal.y), ("goal z [m]", *goal.z)]

  def debug_draw(self, draw: DebugDraw) -> None:
    """Draw the goal as a green ball, and a line from the object to it."""
    worlds = torch.tensor(draw.worlds, device=self.device)
    goal, place = self.goal_pos_w[worlds], self.object_pos_w[worlds]
    draw.spheres(goal, 0.012, (0.2, 0.7, 0.3, 0.8))
    draw.lines(place, goal, (0.2, 0.7, 0.3, 0.6), 0.002)


def _between(share: torch.Tensor, bounds: Range) -> torch.Tensor:
  return bounds[0] + share * (bounds[1] - bounds[0])
