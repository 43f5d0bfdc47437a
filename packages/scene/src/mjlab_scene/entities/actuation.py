"""Targets of an entity's joints, tendons and sites, and their path through actuator models into `ctrl`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, get_args

import torch
from mjlab_actuators import ActuatorSet, Target, Transmission
from mjlab_core import Index, Stateful, as_index, fill_, select, where_
from mjlab_core.torch_internals import version_of

from mjlab_scene.entities.indexing import EntityIndexing
from mjlab_scene.entities.initial_state import InitialState

if TYPE_CHECKING:
  from mjlab_sim import Simulation

Quantity = Literal["position", "velocity", "effort"]
"""Kind of target; the position of a tendon is its length."""

QUANTITIES: tuple[Quantity, ...] = get_args(Quantity)


class Actuation(Stateful):
  """Targets of an entity and the actuator models that turn them into controls.

  Each tensor of targets has the columns of all joints, then of all tendons, then of all sites.

  Args:
    actuators: Actuator models, built here.
    sim: The simulation.
    indexing: Places of the entity's elements.
    initial: State that targets are reset to.
    prefix: Prefix of the entity's names in the model.
    rng: Source of randomness for delays, on the simulation's device.
  """

  def __init__(
    self,
    actuators: ActuatorSet,
    sim: Simulation,
    indexing: EntityIndexing,
    initial: InitialState,
    *,
    prefix: str,
    rng: torch.Generator | None,
  ) -> None:
    self.num_envs, self.device = sim.num_envs, sim.device
    self.actuators, self._sim = actuators, sim
    names = indexing.names
    num_q, num_v = (sum(map(len, of)) for of in (indexing.q_of_joint, indexing.v_of_joint))
    others = [len(names["tendon"]), len(names["site"])]
    self.position = self.state((num_q + sum(others),), dtype=sim.dtype)
    """Position targets, (num_envs, num_joint_pos + num_tendons + num_sites) [rad or m]."""
    self.velocity = self.state((num_v + sum(others),), dtype=sim.dtype)
    """Velocity targets, (num_envs, num_joint_vel + num_tendons + num_sites) [rad/s or m/s]."""
    self.effort = self.state((num_v + sum(others),), dtype=sim.dtype)
    """Effort targets, (num_envs, num_joint_vel + num_tendons + num_sites) [N m or N]."""
    self.views: dict[tuple[Transmission, Quantity], torch.Tensor] = {}
    """Columns of one kind in the targets of one quantity."""
    for quantity, joints in zip(QUANTITIES, (num_q, num_v, num_v), strict=True):
      parts = getattr(self, quantity).split([joints, *others], dim=1)
      self.views |= {(kind, quantity): part for kind, part in zip(get_args(Transmission), parts, strict=True)}
    self._build(indexing, prefix, rng)
    start = [x for name in names["joint"] for x in initial.joint_pos[name]]
    start += [initial.tendon_len[name] for name in names["tendon"]]
    start += [initial.site_pos.get(name, 0.0) for name in names["site"]]
    self._default = torch.tensor([start], dtype=sim.dtype, device=sim.device)
    # A list, because an attribute of a Stateful object is checked whenever it is assigned.
    self._written: list[int] = []
    self.position.copy_(self._default)

  def _build(self, indexing: EntityIndexing, prefix: str, rng: torch.Generator | None) -> None:
    """Build the actuator models, and find their inputs: hinges and slides, then the tendons and sites they drive."""
    sim, names, actuators = self._sim, indexing.names, self.actuators
    actuators.build(
      sim.mj_model,
      num_envs=sim.num_envs,
      device=sim.device,
      dtype=sim.dtype,
      generator=rng,
      prefix=prefix,
      ctrl=sim.data.ctrl,
    )
    targets = actuators.targets
    joints = [target for target in targets if target.transmission == "joint"]
    self._drives_others = len(joints) < len(targets)
    every = [Target(kind, name) for kind in get_args(Transmission) for name in names[kind]]

    def index(of_joint: Sequence[range], chosen: Sequence[Target]) -> Index:
      """Return the columns of targets, if joints have the columns `of_joint` and tendons and sites follow."""
      width = sum(map(len, of_joint))
      starts = [*(own[0] for own in of_joint), *range(width, width + len(every) - len(of_joint))]
      return as_index([starts[every.index(target)] for target in chosen], sim.device)

    self._q_targets, self._v_targets = index(indexing.q_of_joint, targets), index(indexing.v_of_joint, targets)
    self._q, self._v = index(indexing.qpos_of_joint, joints), index(indexing.qvel_of_joint, joints)
    tendons = [names["tendon"].index(name) for name in actuators.driven("tendon")]
    self._tendons = as_index(indexing.ids["tendon"][tendons], sim.device)
    self._outputs = as_index(actuators.site_outputs, sim.device)
    views = isinstance(self._q_targets, slice) and isinstance(self._v_targets, slice)
    self._target_views = self._gather_targets() if views else None
    # For servos inside MuJoCo, the same targets always give the same controls.
    self._holds = not actuators.needs_feedback and all(model.delay is None for model in actuators.groups)

  def reset(self, mask: torch.Tensor) -> None:
    """Reset targets of masked worlds (num_envs,) to the initial state, at rest, and delays with them."""
    where_(self.position, mask, self._default)
    fill_(self.velocity, mask, 0.0)
    fill_(self.effort, mask, 0.0)
    self.actuators.reset(mask, *(self._target_views or self._gather_targets()))
    # The simulation's reset clears controls.
    self._written.clear()

  def write_ctrl(self) -> None:
    """Turn targets into controls. Call it exactly once before each substep."""
    if self._holds:
      # Within a decimation nothing is written twice. The first substep of a recording always writes, because each
      # replay starts from new targets.
      version = version_of(self.position) + version_of(self.velocity) + version_of(self.effort)
      written = [version, self._sim.is_capturing]
      if written == self._written:
        return
      self._written[:] = written
    targets = self._target_views or self._gather_targets()
    measured = targets[:2] if self._holds else self._measurements()
    self.actuators.compute(*targets, *measured)

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
