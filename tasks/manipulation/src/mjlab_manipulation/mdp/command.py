"""The lift command: which object is to go where, and for how long it is asked for."""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import torch
from mjlab_core import DebugDraw
from mjlab_core.masking import where_
from mjlab_core.sampling import check_range
from mjlab_managers import CommandTerm, CommandTermCfg

from mjlab_manipulation.mdp.extent import Extent

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

Range = tuple[float, float]


@dataclass(kw_only=True)
class Region:
  """A box about the origin of each world [m]."""

  x: Range
  y: Range
  z: Range


@dataclass(kw_only=True)
class LiftCommandCfg(CommandTermCfg):
  """At each reset draws which object is to be lifted, where to, where all objects begin, and how long there is for it.

  A goal holds for a whole episode, which `goal_over` ends: nothing moves by itself within one.

  Objects stand in a row: along y any two centres are at least `min_distance` apart, drawn uniformly among all rows for
  which that holds, in an order of their own in every world. So none overlaps another, and no draw is ever rejected.
  Worlds whose objects were made larger since keep them as far apart as these need, at worst beyond the ends of `start`.
  """

  resampling_time_range: tuple[float, float] | None = None
  debug_vis: bool = True
  objects: tuple[str, ...] = ("cube",)
  """Entities that are there; each world is to lift one of them."""
  goal: Region = field(default_factory=lambda: Region(x=(0.3, 0.5), y=(-0.2, 0.2), z=(0.2, 0.4)))
  """Where the centre of the object is to go."""
  start: Region = field(default_factory=lambda: Region(x=(0.22, 0.4), y=(-0.103, 0.103), z=(0.0, 0.03)))
  """Where objects begin, x and y of their origins and z of their lowest points: where the wrist camera sees all of a
  cube of 4 cm from the pose "home"."""
  start_yaw: Range = (-math.pi, math.pi)
  """How objects are turned at the beginning [rad]."""
  min_distance: float = 0.06
  """Least distance between two objects' origins along y [m]; at least what keeps any two apart, however turned."""
  goal_time_range: Range = (8.0, 12.0)
  """How long a goal is asked for [s]."""

  def build(self, env: Any) -> "LiftCommand":
    return LiftCommand(self, env)


class LiftCommand(CommandTerm):
  """See `LiftCommandCfg`.

  Raises:
    ValueError: no object, one that does not exist, does not float or has no extent, an inverted range, or no room for
      all objects.
  """

  cfg: LiftCommandCfg

  def __init__(self, cfg: LiftCommandCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    if cfg.resampling_time_range is not None:
      raise ValueError("resampling_time_range must be None: objects are placed at resets; see goal_time_range")
    self._objects = [env.scene[name] for name in cfg.objects]
    if not self._objects:
      raise ValueError("objects must name at least one entity")
    for name, entity in zip(cfg.objects, self._objects, strict=True):
      if entity.is_fixed_base:
        raise ValueError(f"entity '{name}' cannot be lifted: its base does not float")
    bounds = {
      f"{region}.{axis}": getattr(getattr(cfg, region), axis)
      for region in ("goal", "start")
      for axis in ("x", "y", "z")
    }
    for name, (lo, hi) in {**bounds, "start_yaw": cfg.start_yaw}.items():
      check_range(name, lo, hi)
    check_range("goal_time_range", *cfg.goal_time_range, minimum=env.step_dt)
    count = len(self._objects)
    width = cfg.start.y[1] - cfg.start.y[0]
    if width < (count - 1) * cfg.min_distance:
      raise ValueError(f"start.y is {width:g} m wide, too little for {count} objects {cfg.min_distance:g} m apart")
    self._extents = [Extent(env, entity) for entity in self._objects]
    self._check_distance()
    like: dict[str, Any] = {"device": env.device, "dtype": env.sim.dtype}
    n = self.num_envs
    self._goal = torch.zeros(n, 3, **like)
    self.target = torch.zeros(n, dtype=torch.int64, device=env.device)
    """Which of the objects is to be lifted, (num_envs,)."""
    self.goal_time = torch.zeros(n, dtype=torch.float64, device=env.device)
    """How long after its reset a world is given a new goal, (num_envs,) [s]."""

  @property
  def command(self) -> torch.Tensor:
    """Where the centre of the object is to go, from the origin of its world, (num_envs, 3) [m]."""
    return self._goal

  @property
  def goal_pos_w(self) -> torch.Tensor:
    """Where the centre of the object is to go, world frame, (num_envs, 3) [m]."""
    return self._goal + self.env.scene.env_origins

  @property
  def object_pos_w(self) -> torch.Tensor:
    """Centre of the object that is to be lifted, world frame, (num_envs, 3) [m]."""
    return self._of_target([entity.data.root_link_pos_w for entity in self._objects])

  @property
  def object_quat_w(self) -> torch.Tensor:
    """Orientation of that object, world frame, (num_envs, 4)."""
    return self._of_target([entity.data.root_link_quat_w for entity in self._objects])

  @property
  def object_height(self) -> torch.Tensor:
    """Height of its centre above the origin of its world, (num_envs,) [m]."""
    return self.object_pos_w[:, 2] - self.env.scene.env_origins[:, 2]

  @property
  def object_clearance(self) -> torch.Tensor:
    """Height of its lowest point above the origin of its world, (num_envs,) [m]."""
    return self._of_target([extent.lowest() for extent in self._extents]) - self.env.scene.env_origins[:, 2]

  @property
  def object_size(self) -> torch.Tensor:
    """Edges of the box about it, in the frame of its body, (num_envs, 3) [m]."""
    boxes = [extent.box() for extent in self._extents]
    return self._of_target([(high - low).expand(self.num_envs, 3) for low, high in boxes])

  @property
  def distance(self) -> torch.Tensor:
    """From its centre to the goal, (num_envs,) [m]."""
    return torch.linalg.vector_norm(self.goal_pos_w - self.object_pos_w, dim=-1)

  def of_target(self, values: torch.Tensor) -> torch.Tensor:
    """Of one value for each object (num_envs, objects, ...) that of the object to be lifted, (num_envs, ...)."""
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
    """Where objects are along y, (num_envs, objects) [m], of as many uniform numbers for places and for their order."""
    cfg, count = self.cfg, len(self._objects)
    if count == 1:
      return _between(place, cfg.start.y)
    distance = self._apart().clamp(min=cfg.min_distance)
    slack = cfg.start.y[1] - cfg.start.y[0] - (count - 1) * distance
    row = cfg.start.y[0] + 0.5 * slack.clamp(max=0.0) + torch.arange(count, device=self.device) * distance
    y = row + place.sort(dim=1).values * slack.clamp(min=0.0)
    return y.gather(1, order.argsort(dim=1))

  def _apart(self) -> torch.Tensor:
    """How far apart no two objects can touch, with the sizes they have now, (num_envs or 1, 1) [m]."""
    boxes = [extent.box() for extent in self._extents]
    reach = torch.stack(torch.broadcast_tensors(*(torch.maximum(-low, high)[:, :2] for low, high in boxes)), dim=1)
    return torch.linalg.vector_norm(reach, dim=-1).sort(dim=1).values[:, -2:].sum(1, keepdim=True)

  def _check_distance(self) -> None:
    """Checks, at build, that no two objects can touch."""
    needed = float(self._apart().max())
    if len(self._objects) > 1 and self.cfg.min_distance < needed:
      raise ValueError(f"min_distance is {self.cfg.min_distance:g} m, and objects may touch below {needed:.4g} m")

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
    """A green ball where the object is to go, and a line to it from the object."""
    worlds = torch.tensor(draw.worlds, device=self.device)
    goal, place = self.goal_pos_w[worlds], self.object_pos_w[worlds]
    draw.spheres(goal, 0.012, (0.2, 0.7, 0.3, 0.8))
    draw.lines(place, goal, (0.2, 0.7, 0.3, 0.6), 0.002)


def _between(share: torch.Tensor, bounds: Range) -> torch.Tensor:
  return bounds[0] + share * (bounds[1] - bounds[0])
