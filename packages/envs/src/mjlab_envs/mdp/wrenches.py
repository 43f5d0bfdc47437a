"""Events that push bodies with forces and torques."""

from typing import TYPE_CHECKING, Annotated, cast

import torch
from mjlab_core import DebugDraw, Limits, NonNegativeRange, Range, fill_, quat_apply, uniform, where_
from mjlab_managers import ManagerTermBase, SceneEntityCfg

from mjlab_envs.mdp.events import axis_bounds, drawn

if TYPE_CHECKING:
  from mjlab_envs.env import ManagerBasedRlEnv

Components = Range | dict[str, Range]
"""One range for all three components, or ranges by component (x, y, z), where those left out are 0."""

_ROBOT = SceneEntityCfg("robot")
# Timers are float64, and due this early [s]: rounding of repeated subtraction must not delay one by a step.
_DUE = 1e-6
_METRES_PER_NEWTON = 0.005


class apply_external_force_torque(ManagerTermBase):
  """Draw a force and a torque for each selected body, world frame, at its centre of mass.

  They act until the next draw or the reset of their world; as an event of mode "reset", for the whole episode. Events
  that push the same body replace each other's forces.

  Args:
    env: the environment.
    force_range: range of the force [N].
    torque_range: range of the torque [N m].
    asset: entity and bodies.
  """

  env: "ManagerBasedRlEnv"

  def __init__(
    self,
    env: "ManagerBasedRlEnv",
    *,
    force_range: Components = (0.0, 0.0),
    torque_range: Components = (0.0, 0.0),
    asset: SceneEntityCfg = _ROBOT,
  ) -> None:
    super().__init__(env)
    self._entity, self._bodies = env.scene[asset.name], asset.body_ids
    # A resolved selection holds the selected names.
    self._count = len(cast("tuple[str, ...]", asset.body_names))
    # Lowest and highest force and torque, (1, 2, 1, 3).
    bounds = [_bounds(force_range, "force_range", env), _bounds(torque_range, "torque_range", env)]
    self._lo, self._hi = (torch.stack(ends, 1).unsqueeze(2) for ends in zip(*bounds, strict=True))

  def __call__(self, mask: torch.Tensor) -> None:
    force, torque = self._draw().unbind(1)
    self._entity.write_external_wrench(force, torque, self._bodies, mask)

  def _draw(self) -> torch.Tensor:
    """Return forces and torques of all bodies, (num_envs, 2, bodies, 3)."""
    return drawn(self.env, self._lo, self._hi, 2, self._count, 3)


class apply_body_impulse(apply_external_force_torque):
  """Push the selected bodies for a short while, again and again; for events of mode "step".

  Each world waits for a time drawn from `cooldown_s`, is pushed for one drawn from `duration_s`, both in whole steps,
  and begins again. A reset begins with a wait. Each body has its own force and torque, world frame, constant during a
  push.

  Args:
    env: the environment.
    cooldown_s: range of the time without a push [s].
    duration_s: range of the length of a push [s].
    force_range: range of the force [N].
    torque_range: range of the torque [N m].
    body_point_offset: point of the body at which the force acts, from its centre of mass, in the axes of its link [m].
    asset: entity and bodies.
  """

  def __init__(
    self,
    env: "ManagerBasedRlEnv",
    *,
    cooldown_s: NonNegativeRange,
    duration_s: Annotated[Range, Limits(gt=0)],
    force_range: Components = (0.0, 0.0),
    torque_range: Components = (0.0, 0.0),
    body_point_offset: tuple[float, float, float] | None = None,
    asset: SceneEntityCfg = _ROBOT,
  ) -> None:
    super().__init__(env, force_range=force_range, torque_range=torque_range, asset=asset)
    self._times = torch.tensor([cooldown_s, duration_s], dtype=torch.float64, device=env.device)
    self._offset = None
    if body_point_offset is not None:
      self._offset = torch.tensor(body_point_offset, device=env.device, dtype=env.sim.dtype)
    self.active = self.state(dtype=torch.bool)
    """Worlds that are being pushed, bool (num_envs,)."""
    self._time_left = self.state_of(self._draw_time(torch.zeros_like(self.active)))
    self._wrench = self.state((2, self._count, 3), dtype=env.sim.dtype)

  def __call__(self, mask: torch.Tensor) -> None:
    # No time has passed in a world that was just reset.
    passed = mask & ~self.env.reset_buf
    self._time_left.sub_(passed.double(), alpha=self.env.step_dt)
    turns = passed & (self._time_left <= _DUE)
    ends = turns & self.active
    self.active.logical_xor_(turns)
    where_(self._time_left, turns, self._draw_time(self.active))
    where_(self._wrench, turns & self.active, self._draw())
    fill_(self._wrench, ends, 0.0)
    force, torque = self._wrench.unbind(1)
    writes = turns
    if self._offset is not None:
      # The arm turns with the body, so its torque is renewed in every step.
      writes = turns | self.active
      turned = quat_apply(self._entity.data.body_link_quat_w[:, self._bodies], self._offset)
      torque = torque + torch.linalg.cross(turned, force)
    self._entity.write_external_wrench(force, torque, self._bodies, writes)

  def reset(self, mask: torch.Tensor) -> None:
    """Begin the worlds of `mask`, bool (num_envs,), with a wait; the simulation's reset has taken their forces away."""
    fill_(self.active, mask, False)
    fill_(self._wrench, mask, 0.0)
    where_(self._time_left, mask, self._draw_time(self.active))

  def _draw_time(self, pushing: torch.Tensor) -> torch.Tensor:
    """Return the duration of the push or of the wait of each world, float64 (num_envs,) [s]."""
    lo, hi = self._times.index_select(0, pushing.long()).unbind(1)
    return uniform(lo, hi, (self.num_envs,), generator=self.env.rng, device=self.device, dtype=torch.float64)

  def debug_draw(self, draw: DebugDraw) -> None:
    """Show each force as an arrow at its body, 5 mm per newton."""
    worlds = torch.tensor(draw.worlds, device=self.device)
    start = self._entity.data.body_com_pos_w[:, self._bodies][worlds]
    force = self._wrench[worlds, 0]
    shown = torch.linalg.vector_norm(force, dim=-1) > 1.0
    start, force = start[shown], force[shown]
    draw.arrows(start, start + _METRES_PER_NEWTON * force, (0.9, 0.3, 0.6, 1.0), 0.012)


def _bounds(components: Components, name: str, env: "ManagerBasedRlEnv") -> tuple[torch.Tensor, torch.Tensor]:
  """Return the lowest and the highest values of x, y and z, (1, 3)."""
  by_axis = components if isinstance(components, dict) else dict.fromkeys("xyz", components)
  return axis_bounds(by_axis, name, env, "xyz")
