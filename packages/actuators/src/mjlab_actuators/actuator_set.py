"""All actuators of one entity: from targets to the entity's part of ctrl, once a substep."""

import itertools
import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

import mujoco
import torch
from mjlab_core import MjlabError, Stateful, StatefulDict, UnknownNameError, as_index, as_slice, select

from mjlab_actuators.actuator import COMMAND_FIELDS, Actuator, ActuatorCmd, ActuatorGroup, Column
from mjlab_actuators.actuator_cfg import ActuatorCfg
from mjlab_actuators.models.native import PassThrough
from mjlab_actuators.transmission import Target, Transmission, targets_of, targets_of_actuators


class ActuatorSet(Stateful):
  """Actuators of an entity, built, fused and run together.

  Call `edit_spec` before the model is compiled and `build` after; then `compute` in every substep, and `reset` for
  worlds that restart. Targets and measurements have one column per element, in the model's order: all hinges and
  slides, then the tendons, then the sites that are driven. The place of each command in ctrl is found by name at build,
  so the orders of MuJoCo's elements and of the configs do not matter.

  Attributes, after `build`:
    groups: The actuator models, one per class, settings and delay.
    targets: Joints, tendons and sites of the columns.
    ctrl_ids: Indices into the model's ctrl that this set drives, ascending.
    site_outputs: For each driven site, where `actuator_length` and `actuator_velocity` hold its position and velocity
      along the wrench.
    ctrl: Commands of the last substep, (num_envs, len(ctrl_ids)), fixed memory; a view of the simulation's ctrl where
      `build` was given that and the driven indices are contiguous.
    velocity_limits: Top speeds of driven targets, where configs state them [m/s or rad/s].
    needs_feedback: True if any actuator model reads measurements; if not, `compute` may be given any tensors for them.
  """

  groups: tuple[Actuator, ...]
  targets: tuple[Target, ...]
  ctrl_ids: tuple[int, ...]
  site_outputs: tuple[int, ...]
  ctrl: torch.Tensor
  velocity_limits: dict[Target, float]
  needs_feedback: bool

  def __init__(self, cfgs: Sequence[ActuatorCfg], owner: str = "") -> None:
    """Keep the configs; `owner` names the entity in messages, e.g. "entity 'robot'"."""
    self.cfgs = tuple(cfgs)
    self.owner = owner

  def edit_spec(self, spec: mujoco.MjSpec) -> None:
    """Add the configured MuJoCo actuators and joint properties, after the actuators that the MJCF declares.

    Args:
      spec: The entity alone, its names without prefix.

    Raises:
      UnknownNameError: A pattern matches nothing of its kind; the message names another kind that it matches.
      MjlabError: A number is impossible, or a target is driven twice.
    """
    targets, actuated = targets_of(spec), set(targets_of_actuators(spec))
    for cfg in self.cfgs:
      cfg.edit_spec(spec, self._match(cfg, targets, actuated))

  def build(
    self,
    model: mujoco.MjModel,
    *,
    num_envs: int,
    device: torch.device | str,
    dtype: torch.dtype,
    generator: torch.Generator | None = None,
    prefix: str = "",
    ctrl: torch.Tensor | None = None,
  ) -> "ActuatorSet":
    """Make the actuator models and their memory for a compiled model.

    Args:
      model: The compiled model, of this entity alone or of a whole scene.
      num_envs: Number of worlds.
      device: Device of targets and ctrl.
      dtype: Type of targets and ctrl.
      generator: Source of delay lags; None takes torch's global one.
      prefix: Prefix that the scene puts before the entity's names, such as "robot/".
      ctrl: The simulation's ctrl, (num_envs, model.nu), to be written into; None keeps the commands in `self.ctrl`.

    Returns:
      Itself.

    Raises:
      MjlabError: An actuator is missing in the model, or is driven by two configs.
    """
    self.num_envs = num_envs
    targets = targets_of(model, prefix)
    groups = self._groups(model, targets, prefix)
    column_of: dict[int, Column] = {}
    for column in itertools.chain.from_iterable(groups.values()):
      if column.ctrl in column_of:
        kind, name = column.target
        raise MjlabError(f"{self.owner}: {kind} {name!r} is driven by two actuator configs".removeprefix(": "))
      column_of[column.ctrl] = column
    # A site that the MJCF drives too has the element of its config last, which is the one that needs a measurement.
    elements = {column.target: column.element for _, column in sorted(column_of.items())}
    self._driven = set(elements)
    self.targets = tuple(target for target in targets if target.transmission == "joint" or target in elements)
    self.ctrl_ids = tuple(sorted(column_of))
    self.site_outputs = tuple(
      int(model.actuator_outadr[elements[Target("site", name)]]) for name in self.driven("site")
    )
    self._all_ctrl = torch.zeros(num_envs, model.nu, device=device, dtype=dtype) if ctrl is None else ctrl
    self._index = as_index(self.ctrl_ids, self._all_ctrl.device)
    self.ctrl = select(self._all_ctrl, self._index)
    self._routes = [
      _Route(group, columns, self.targets, self._all_ctrl, generator) for group, columns in groups.items()
    ]
    self.groups = tuple(route.actuator for route in self._routes)
    self._laws = StatefulDict({str(index): actuator for index, actuator in enumerate(self.groups)})
    self.needs_feedback = any(actuator.needs_feedback for actuator in self.groups)
    return self

  def compute(
    self,
    position_target: torch.Tensor,
    velocity_target: torch.Tensor,
    effort_target: torch.Tensor,
    position: torch.Tensor,
    velocity: torch.Tensor,
  ) -> torch.Tensor:
    """Return the commands of this substep, (num_envs, len(ctrl_ids)), in `self.ctrl` and in the ctrl given to `build`.

    Call it exactly once a substep: it advances delays. All arguments are (num_envs, len(targets)).
    """
    targets = (position_target, velocity_target, effort_target)
    cmd: ActuatorCmd | None = None
    for route in self._routes:
      if route.gather is None:
        cmd = ActuatorCmd(*targets, position, velocity) if cmd is None else cmd
        route.run(cmd)
      else:
        field, index, into = route.gather
        torch.index_select(targets[field], 1, index, out=into)
    if not isinstance(self._index, slice):
      torch.index_select(self._all_ctrl, 1, self._index, out=self.ctrl)
    return self.ctrl

  def reset(
    self,
    mask: torch.Tensor,
    position_target: torch.Tensor,
    velocity_target: torch.Tensor,
    effort_target: torch.Tensor,
  ) -> None:
    """Start masked worlds as if these targets, (num_envs, len(targets)), had always been given.

    Time does not pass: nothing is pushed, and worlds outside `mask` (num_envs,) stay bit-identical. The entity gives
    its default pose, so that a delayed robot holds it rather than driving to zero.
    """
    # Measurements play no part in a reset.
    cmd = ActuatorCmd(position_target, velocity_target, effort_target, position_target, velocity_target)
    for route in self._routes:
      route.reset(mask, cmd)

  @property
  def target_names(self) -> tuple[str, ...]:
    """Names of the columns."""
    return tuple(target.name for target in self.targets)

  def driven(self, transmission: Transmission) -> tuple[str, ...]:
    """Return the names of the joints, tendons or sites that an actuator drives, in the order of their columns."""
    return tuple(
      target.name for target in self.targets if target in self._driven and target.transmission == transmission
    )

  def _match(self, cfg: ActuatorCfg, targets: Sequence[Target], actuated: set[Target | None]) -> list[str]:
    """Return the names that `cfg` drives; `actuated` are the targets that have an actuator in the MJCF."""
    kind = cfg.transmission_type
    names = [of.name for of in targets if of.transmission == kind and (of in actuated or not cfg.of_mjcf)]
    try:
      return cfg.match(names, self.owner)
    except UnknownNameError as error:
      if isinstance(error.__cause__, re.error):
        raise
      lost = [pattern for pattern in cfg.target_names_expr if not any(re.fullmatch(pattern, name) for name in names)]
      for other, name in targets:
        if other != kind and any(re.fullmatch(pattern, name) for pattern in lost):
          raise UnknownNameError(f"{error} There is a {other} {name!r}: transmission_type={other!r}?") from error
      raise

  def _groups(self, model: mujoco.MjModel, targets: Sequence[Target], prefix: str) -> dict[ActuatorGroup, list[Column]]:
    """Return the columns of all configs by what is computed together, and keep the top speeds."""
    left: dict[Target | None, list[int]] = defaultdict(list)
    for index, target in enumerate(targets_of_actuators(model, prefix)):
      left[target].append(index)
    groups: dict[ActuatorGroup, list[Column]] = defaultdict(list)
    self.velocity_limits = {}
    # Configs that wrap the MJCF come last: they leave the actuators of other configs alone.
    for cfg in sorted(self.cfgs, key=lambda cfg: cfg.of_mjcf):
      names = self._match(cfg, targets, {target for target, ids in left.items() if ids})
      driven = [Target(cfg.transmission_type, name) for name in names]
      elements = {of: left[of] if cfg.of_mjcf else [_own(cfg, model, of, left[of], prefix)] for of in driven}
      for group, columns in cfg.groups(model, elements).items():
        groups[group] += columns
      self.velocity_limits |= cfg.velocity_limits(names)
    return groups


def _own(cfg: ActuatorCfg, model: mujoco.MjModel, target: Target, left: list[int], prefix: str) -> int:
  """Take the actuator that `cfg` added to a target, the last one, from the target's actuators."""
  name = prefix + target.name
  if not left or model.actuator(left[-1]).name not in (name, f"{name}_{target.transmission}"):
    raise MjlabError(f"{type(cfg).__name__}: the model has no actuator {name!r}; call edit_spec before it is compiled")
  return left.pop()


class _Route:
  """Path of one actuator model from the columns of targets into ctrl."""

  def __init__(
    self,
    group: ActuatorGroup,
    columns: Sequence[Column],
    targets: Sequence[Target],
    ctrl: torch.Tensor,
    generator: torch.Generator | None,
  ) -> None:
    source = {target: index for index, target in enumerate(targets)}
    passes = issubclass(group.actuator_model, PassThrough)
    # A pass-through is cheapest in ctrl order: one gather straight into ctrl. Others read several tensors, whose
    # columns are plain slices when they keep the order of the targets.
    columns = sorted(columns, key=lambda column: column.ctrl if passes else source[column.target])
    self.actuator = group.actuator_model(
      group, columns, num_envs=len(ctrl), device=ctrl.device, dtype=ctrl.dtype, generator=generator
    )
    sources = [source[column.target] for column in columns]
    places = [column.ctrl for column in columns]
    self._columns = None if sources == list(range(len(targets))) else as_index(sources, ctrl.device)
    self._ctrl, self._places, place = ctrl, torch.tensor(places, device=ctrl.device), as_slice(places)
    self._into = None if place is None else ctrl[:, place]
    self._fields = group.command_fields
    self.gather: tuple[int, torch.Tensor, torch.Tensor] | None = None
    """For targets that go to ctrl as they are: the index in `COMMAND_FIELDS`, their columns, and where they go."""
    is_plain = type(self.actuator) is PassThrough and not self.actuator.is_geared and self.actuator.delay is None
    if is_plain and self._into is not None and self._columns is not None:
      self.gather = (COMMAND_FIELDS.index(self._fields[0]), torch.tensor(sources, device=ctrl.device), self._into)

  def run(self, cmd: ActuatorCmd) -> None:
    value = self.actuator.compute(self._select(cmd))
    if self._into is not None:
      self._into.copy_(value)
    else:
      self._ctrl.index_copy_(1, self._places, value)

  def reset(self, mask: torch.Tensor, cmd: ActuatorCmd) -> None:
    if self.actuator.delay is not None or type(self.actuator).reset is not Actuator.reset:
      self.actuator.reset(mask, self._select(cmd))

  def _select(self, cmd: ActuatorCmd) -> ActuatorCmd:
    """Return the columns of this actuator model; fields that it does not read are handed over whole."""
    columns = self._columns
    if columns is None:
      return cmd
    fields = (*self._fields, "position", "velocity") if self.actuator.needs_feedback else self._fields
    read = [getattr(cmd, field) for field in fields]
    if isinstance(columns, slice) or len(read) == 1:
      selected = [select(value, columns) for value in read]
    else:
      selected = torch.stack(read).index_select(2, columns).unbind(0)
    return replace(cmd, **dict(zip(fields, selected, strict=True)))
