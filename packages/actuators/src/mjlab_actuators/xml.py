"""Actuators that the MJCF declares itself, kept exactly as they are written."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
from mjlab_core import MjlabError, check_fields, match_names, require

from mjlab_actuators.actuator import ActuatorGroup, CommandField
from mjlab_actuators.actuator_cfg import ActuatorCfg
from mjlab_actuators.native import PassThrough
from mjlab_actuators.transmission import Target, Transmission, actuators_of, targets_of

# The order in which MuJoCo lays out the inputs of an actuator with several.
_INPUTS: tuple[tuple[mujoco.mjtCtrlInput, CommandField], ...] = (
  (mujoco.mjtCtrlInput.mjINPUT_POS, "position_target"),
  (mujoco.mjtCtrlInput.mjINPUT_VEL, "velocity_target"),
  (mujoco.mjtCtrlInput.mjINPUT_FF, "effort_target"),
  (mujoco.mjtCtrlInput.mjINPUT_VOLTAGE, "effort_target"),
)


@dataclass(kw_only=True)
class XmlActuatorCfg(ActuatorCfg):
  """Drive of the actuators that the MJCF declares on joints, tendons or sites; it adds and changes nothing on them.

  Targets are those of the joint or tendon: ctrl of an actuator with a gear is the position or velocity target times the
  gear, or the effort target over it. Which target an actuator takes is read from its gain, bias and dynamics. Patterns
  match names of joints (tendons, sites) that have an actuator in the MJCF; every actuator of such a target is driven.
  The MJCF says where the wrench of a site points.
  """

  command_field: CommandField | None = None
  """Target to hand over, for all; None reads it from each actuator."""

  actuator_model = PassThrough

  def match(self, candidates: Sequence[str], owner: str = "", actuated: Sequence[str] | None = None) -> list[str]:
    """Return the names to drive among `candidates`; with `actuated`, only names with an actuator can match."""
    if actuated is not None:
      candidates = [name for name in candidates if name in actuated]
    check_fields(self, type(self).__name__)
    what = f"{self.transmission_type} with an MJCF actuator"
    return match_names(self.target_names_expr, candidates, what=what, owner=owner)[1]

  def _site_problems(self, target_names: Sequence[str]) -> Iterator[str]:
    yield from self._given(("site_gear", "refsite"), "the MJCF has it already")

  def _add_elements(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    pass

  def _group(self, target_names: Sequence[str], ctrl_ids: Sequence[int]) -> ActuatorGroup:
    missing = "XmlActuatorCfg: without a model, command_field must name the target to hand over"
    field = require(self.command_field, str, missing)
    return replace(super()._group(target_names, ctrl_ids), command_fields=(field,))

  def groups(
    self,
    model: mujoco.MjModel,
    target_names: Sequence[str],
    prefix: str = "",
    without: Collection[int] = (),
  ) -> list[ActuatorGroup]:
    """Return one group per kind of target among these actuators, except those with an id in `without`.

    Raises:
      MjlabError: A target has no actuator, the kind of target of one is unknown and `command_field` is not given, or
        two on one site would get the same target for different wrenches.
    """
    found: dict[CommandField, tuple[list[Target], list[int], list[float]]] = {}
    for name in target_names:
      target = Target(self.transmission_type, name)
      elements = [index for index in actuators_of(model, target, prefix) if index not in without]
      if not elements:
        raise MjlabError(f"XmlActuatorCfg: {target.transmission} {prefix + name!r} has no actuator in the MJCF")
      for element in elements:
        first = int(model.actuator_ctrladr[element])
        for offset, field in enumerate(self._fields(model, element)):
          targets, ids, gears = found.setdefault(field, ([], [], []))
          if target.transmission == "site" and target in targets:
            raise MjlabError(
              f"XmlActuatorCfg: site {prefix + name!r} has one {field}, but several actuators that take one; give each "
              "a site of its own, or leave the site out and write its ctrl"
            )
          targets.append(target)
          ids.append(first + offset)
          gears.append(_gear(model, element))
    return [
      ActuatorGroup(
        actuator_model=PassThrough,
        targets=tuple(targets),
        command_fields=(field,),
        parameters={} if all(gear == 1.0 for gear in gears) else {"gear": tuple(gears)},
        delay=self.delay,
        ctrl_ids=tuple(ids),
      )
      for field, (targets, ids, gears) in found.items()
    ]

  def _fields(self, model: mujoco.MjModel, actuator: int) -> tuple[CommandField, ...]:
    width = int(model.actuator_ctrlnum[actuator])
    fields = (self.command_field,) if self.command_field is not None else command_fields_of(model, actuator)
    if len(fields) != width:
      name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, actuator)
      raise MjlabError(
        f"XmlActuatorCfg: cannot tell which target actuator {name!r} takes ({width} inputs, "
        f"recognised: {', '.join(fields) or 'none'}); set command_field, or leave the actuator out"
      )
    return fields


def command_fields_of(source: mujoco.MjModel | mujoco.MjsActuator, actuator: int = 0) -> tuple[CommandField, ...]:
  """Return the targets that an actuator of a compiled model, or of a spec, takes: one per input, empty if unknown.

  The bias shows the kind of actuator: a position servo subtracts its own gain times the length, a velocity servo its
  own gain times the velocity. The voltage of a DC motor is its effort target.
  """

  def number(name: str) -> Any:
    return (
      getattr(source, name) if isinstance(source, mujoco.MjsActuator) else getattr(source, f"actuator_{name}")[actuator]
    )

  kind, bias = mujoco.mjtGain(int(number("gaintype"))), mujoco.mjtBias(int(number("biastype")))
  dynamics = mujoco.mjtDyn(int(number("dyntype")))
  gain = float(number("gainprm")[0])
  on_length, on_velocity = (float(value) for value in number("biasprm")[1:3])
  if kind in (mujoco.mjtGain.mjGAIN_PID, mujoco.mjtGain.mjGAIN_DCMOTOR):
    spec = int(number("ctrlspec"))
    return tuple(field for bit, field in _INPUTS if spec & int(bit))
  if kind == mujoco.mjtGain.mjGAIN_MUSCLE:
    return ("effort_target",)
  if kind != mujoco.mjtGain.mjGAIN_FIXED:
    return ()
  if dynamics == mujoco.mjtDyn.mjDYN_INTEGRATOR:
    return ("velocity_target",) if bias == mujoco.mjtBias.mjBIAS_AFFINE and on_length == -gain else ()
  if dynamics not in (mujoco.mjtDyn.mjDYN_NONE, mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT):
    return ()
  if bias == mujoco.mjtBias.mjBIAS_NONE:
    return ("effort_target",)
  if bias == mujoco.mjtBias.mjBIAS_AFFINE and gain != 0.0:
    if on_length == -gain:
      return ("position_target",)
    if on_length == 0.0 and on_velocity == -gain:
      return ("velocity_target",)
  return ()


def _gear(model: mujoco.MjModel, actuator: int) -> float:
  """Return the gear between targets and ctrl: 1 for volts, activations of muscles, and wrenches at sites."""
  kind = mujoco.mjtGain(model.actuator_gaintype[actuator])
  volts = int(mujoco.mjtCtrlInput.mjINPUT_VOLTAGE)
  is_voltage = kind == mujoco.mjtGain.mjGAIN_DCMOTOR and bool(int(model.actuator_ctrlspec[actuator]) & volts)
  at_site = model.actuator_trntype[actuator] == int(mujoco.mjtTrn.mjTRN_SITE)
  gear = float(model.actuator_gear[model.actuator_outadr[actuator], 0])
  return 1.0 if is_voltage or at_site or kind == mujoco.mjtGain.mjGAIN_MUSCLE or gear == 0.0 else gear


def targets_with_actuator(
  model: mujoco.MjModel, transmission: Transmission, prefix: str = "", without: Collection[int] = ()
) -> list[str]:
  """Return the names that an actuator drives whose id is not in `without`, prefix removed, in model order."""
  return [
    name
    for name in targets_of(model, transmission, prefix)
    if any(index not in without for index in actuators_of(model, Target(transmission, name), prefix))
  ]
