"""Targets of an entity's joints, tendons and sites, and their way through actuator models into `ctrl`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import torch
from mjlab_actuators import ActuatorSet, Transmission
from mjlab_core import Stateful, as_index, fill_, select, where_

from mjlab_scene.indexing import EntityIndexing
from mjlab_scene.initial_state import InitialState

if TYPE_CHECKING:
  from mjlab_sim import Simulation

Quantity = Literal["position", "velocity", "effort"]
"""Kind of target; the position of a tendon is its length."""


class Actuation(Stateful):
  """Targets of an entity and the actuator models that turn them into controls.

  Each tensor of targets has the columns of all joints, then of all tendons, then of all sites.

  Args:
    actuators: Actuator models, built here; None if nothing is driven.
    sim: The simulation.
    indexing: Places of the entity's elements.
    initial: Start of the entity, to which targets are reset.
    prefix: What precedes the entity's names in the model.
    rng: Source of randomness for delays, on the simulation's device.
  """

  def __init__(
    self,
    actuators: ActuatorSet | None,
    sim: Simulation,
    indexing: EntityIndexing,
    initial: InitialState,
    *,
    prefix: str,
    rng: torch.Generator | None,
  ) -> None:
    self.num_envs, self.device = sim.num_envs, sim.device
    self._actuators, self._sim = actuators, sim
    names = indexing.names
    self._widths = {kind: len(names[kind]) for kind in ("tendon", "site")}
    self._num_q, self._num_v = (sum(map(len, of)) for of in (indexing.q_of_joint, indexing.v_of_joint))
    others = sum(self._widths.values())
    self.position = self.state((self._num_q + others,), dtype=sim.dtype)
    """Position targets, (num_envs, num_joint_pos + num_tendons + num_sites) [rad or m]."""
    self.velocity = self.state((self._num_v + others,), dtype=sim.dtype)
    """Velocity targets, (num_envs, num_joint_vel + num_tendons + num_sites) [rad/s or m/s]."""
    self.effort = self.state((self._num_v + others,), dtype=sim.dtype)
    """Effort targets, (num_envs, num_joint_vel + num_tendons + num_sites) [N m or N]."""
    if actuators is not None:
      self._build(actuators, indexing, prefix, rng)
    start = [x for name in names["joint"] for x in initial.joint_pos[name]]
    start += [initial.tendon_len[name] for name in names["tendon"]]
    start += [initial.site_pos.get(name, 0.0) for name in names["site"]]
    self._default = torch.tensor([start], dtype=sim.dtype, device=sim.device)
    # A list, because an attribute of a Stateful object is checked whenever it is assigned.
    self._written: list[int] = []
    self.position.copy_(self._default)

  def _build(self, actuators: ActuatorSet, indexing: EntityIndexing, prefix: str, rng: torch.Generator | None) -> None:
    """Build the actuator models, and find what they read: scalar joints, then the tendons and sites they drive."""
    sim, names = self._sim, indexing.names
    # Actuators do not know ball joints.
    scalar = [joint for joint, columns in enumerate(indexing.q_of_joint) if len(columns) == 1]
    actuators.build(
      sim.mj_model,
      target_names=[names["joint"][joint] for joint in scalar],
      num_envs=sim.num_envs,
      device=sim.device,
      dtype=sim.dtype,
      generator=rng,
      prefix=prefix,
      ctrl=sim.data.ctrl,
    )
    tendons = [names["tendon"].index(name) for name in actuators.driven("tendon")]
    sites = [names["site"].index(name) for name in actuators.driven("site")]
    self._drives_others = bool(tendons or sites)
    others = [*tendons, *(len(names["tendon"]) + site for site in sites)]

    def columns(of_joint: tuple[range, ...], width: int) -> list[int]:
      return [*(of_joint[joint][0] for joint in scalar), *(width + other for other in others)]

    self._q_targets = as_index(columns(indexing.q_of_joint, self._num_q), sim.device)
    self._v_targets = as_index(columns(indexing.v_of_joint, self._num_v), sim.device)
    self._q = as_index([indexing.qpos_of_joint[joint][0] for joint in scalar], sim.device)
    self._v = as_index([indexing.qvel_of_joint[joint][0] for joint in scalar], sim.device)
    self._tendons = as_index(indexing.ids["tendon"][tendons], sim.device)
    self._outputs = as_index(actuators.site_outputs, sim.device)
    views = isinstance(self._q_targets, slice) and isinstance(self._v_targets, slice)
    self._target_views = self._gather_targets() if views else None
    # Servos inside MuJoCo: the same targets always give the same controls.
    self._holds = not actuators.needs_feedback and all(model.delay is None for model in actuators.groups)

  def view(self, kind: Transmission, quantity: Quantity) -> torch.Tensor:
    """Return the columns of one kind in the targets of one quantity, a view."""
    targets, joints = (self.position, self._num_q) if quantity == "position" else (getattr(self, quantity), self._num_v)
    if kind == "joint":
      return targets[:, :joints]
    start = joints + (self._widths["tendon"] if kind == "site" else 0)
    return targets[:, start : start + self._widths[kind]]

  @property
  def joint_vel_limits(self) -> dict[str, float]:
    """Top speeds of joints by name, of those whose actuator states one [rad/s or m/s]."""
    limits = {} if self._actuators is None else self._actuators.velocity_limits
    return {target.name: limit for target, limit in limits.items() if target.transmission == "joint"}

  def reset(self, mask: torch.Tensor) -> None:
    """Reset targets of masked worlds (num_envs,) to the initial state, at rest, and delays with them."""
    where_(self.position, mask, self._default)
    fill_(self.velocity, mask, 0.0)
    fill_(self.effort, mask, 0.0)
    if self._actuators is not None:
      self._actuators.reset(mask, *(self._target_views or self._gather_targets()))
    # The simulation's reset clears controls.
    self._written.clear()

  def write_ctrl(self) -> None:
    """Turn targets into controls; to be called exactly once before each substep."""
    if self._actuators is None:
      return
    if self._holds:
      # Within a decimation there is nothing to write twice. The first substep of a recording writes whatever was
      # written before it, because each replay starts from new targets.
      version = self.position._version + self.velocity._version + self.effort._version
      written = [version, self._sim.is_capturing]
      if written == self._written:
        return
      self._written[:] = written
    targets = self._target_views or self._gather_targets()
    measured = targets[:2] if self._holds else self._measurements()
    self._actuators.compute(*targets, *measured)

  def _gather_targets(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    v = self._v_targets
    return select(self.position, self._q_targets), select(self.velocity, v), select(self.effort, v)

  def _measurements(self) -> tuple[torch.Tensor, torch.Tensor]:
    sim = self._sim
    position, velocity = select(sim.data.qpos, self._q), select(sim.data.qvel, self._v)
    if not self._drives_others:
      return position, velocity
    sim.forward()
    data, outputs = sim.data, self._outputs
    lengths = (position, select(data.ten_length, self._tendons), select(data.actuator_length, outputs))
    rates = (velocity, select(data.ten_velocity, self._tendons), select(data.actuator_velocity, outputs))
    return torch.cat(lengths, dim=1), torch.cat(rates, dim=1)
