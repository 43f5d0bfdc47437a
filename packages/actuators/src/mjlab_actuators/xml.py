"""Actuators that the MJCF declares itself, kept exactly as they are written."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import mujoco
from mjlab_core import MjlabError

from mjlab_actuators.actuator import ActuatorGroup, Column, CommandField
from mjlab_actuators.actuator_cfg import ActuatorCfg
from mjlab_actuators.native import PassThrough
from mjlab_actuators.native_dc_motor import INPUTS
from mjlab_actuators.transmission import Target


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

  of_mjcf = True
  actuator_model = PassThrough

  def _site_problems(self, target_names: Sequence[str]) -> Iterator[str]:
    yield from self._given(("site_gear", "refsite"), "the MJCF has it already")

  def _add_elements(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    pass

  def groups(self, model: mujoco.MjModel, elements: Mapping[str, Sequence[int]]) -> list[ActuatorGroup]:
    """Return one group per kind of target among these actuators.

    Raises:
      MjlabError: The kind of target of an actuator is unknown and `command_field` is not given, or two on one site
        would get the same target for different wrenches.
    """
    found: dict[CommandField, list[Column]] = defaultdict(list)
    for name, ids in elements.items():
      target = Target(self.transmission_type, name)
      for element in ids:
        first = int(model.actuator_ctrladr[element])
        for ctrl, field in enumerate(self._fields(model, element), first):
          if target.transmission == "site" and any(column.target == target for column in found[field]):
            raise MjlabError(
              f"XmlActuatorCfg: site {name!r} has one {field}, but several actuators that take one; give each a "
              "separate site, or leave the site out and write its ctrl"
            )
          found[field].append(Column(target, {}, ctrl, _gear(model, element)))
    return [self._group_of(columns, (field,)) for field, columns in found.items()]

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


def command_fields_of(model: mujoco.MjModel, actuator: int) -> tuple[CommandField, ...]:
  """Return the targets that an actuator of a compiled model takes: one per input, empty if unknown.

  The bias shows the kind of actuator: a position servo subtracts its own gain times the length, a velocity servo its
  own gain times the velocity. The voltage of a DC motor is its effort target.
  """
  kind, bias = mujoco.mjtGain(model.actuator_gaintype[actuator]), mujoco.mjtBias(model.actuator_biastype[actuator])
  dynamics = mujoco.mjtDyn(model.actuator_dyntype[actuator])
  gain = model.actuator_gainprm[actuator, 0]
  on_length, on_velocity = model.actuator_biasprm[actuator, 1:3]
  if kind in (mujoco.mjtGain.mjGAIN_PID, mujoco.mjtGain.mjGAIN_DCMOTOR):
    bits = int(model.actuator_ctrlspec[actuator])
    fields: list[CommandField] = [field for field, bit in INPUTS.items() if bits & int(bit)]
    if bits & int(mujoco.mjtCtrlInput.mjINPUT_VOLTAGE):
      fields.append("effort_target")
    return tuple(fields)
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
