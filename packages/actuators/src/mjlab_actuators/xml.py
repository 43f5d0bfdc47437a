"""Actuators that the MJCF declares, kept exactly as they are written."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
from mjlab_core import MjlabError

from mjlab_actuators.actuator import CommandField
from mjlab_actuators.actuator_cfg import ActuatorCfg, CtrlInput
from mjlab_actuators.models.native import PassThrough
from mjlab_actuators.models.native_dc_motor import INPUTS

_VOLTAGE = int(mujoco.mjtCtrlInput.mjINPUT_VOLTAGE)
_CONTROLLER_INPUTS: tuple[tuple[CommandField, int], ...] = (*INPUTS.items(), ("effort_target", _VOLTAGE))
_LINEAR = (mujoco.mjtDyn.mjDYN_NONE, mujoco.mjtDyn.mjDYN_FILTER, mujoco.mjtDyn.mjDYN_FILTEREXACT)


@dataclass(kw_only=True)
class XmlActuatorCfg(ActuatorCfg):
  """Actuators that the MJCF declares on joints, tendons or sites; nothing on them is added or changed.

  Targets are those of the joint or tendon: ctrl of an actuator with a gear is the position or velocity target times the
  gear, or the effort target over it. Which target an actuator takes is read from its gain, bias and dynamics. Patterns
  match names of joints (tendons, sites) that have an actuator in the MJCF; every actuator of such a target is driven.
  The MJCF defines the direction of the wrench of a site.
  """

  command_field: CommandField | None = None
  """Target to hand over, for all; None reads it from each actuator."""

  of_mjcf = True
  actuator_model = PassThrough

  def _site_problems(self, target_names: Sequence[str]) -> Iterator[str]:
    yield from self._given(("site_gear", "refsite"), "the MJCF has it already")

  def _add_elements(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    pass

  def ctrl_inputs(self, model: mujoco.MjModel, element: int) -> list[CtrlInput]:
    """Return the target of each input of an actuator; volts, muscles and sites have no gear.

    Raises:
      MjlabError: The kind of target is unknown, and `command_field` is not given.
    """
    width = int(model.actuator_ctrlnum[element])
    fields = (self.command_field,) if self.command_field is not None else command_fields_of(model, element)
    if len(fields) != width:
      raise MjlabError(
        f"XmlActuatorCfg: cannot tell which target actuator {model.actuator(element).name!r} takes ({width} inputs, "
        f"recognised: {', '.join(fields) or 'none'}); set command_field, or leave the actuator out"
      )
    is_voltage = bool(model.actuator_ctrlspec[element] & _VOLTAGE)
    is_muscle = model.actuator_gaintype[element] == mujoco.mjtGain.mjGAIN_MUSCLE
    is_plain = is_voltage or is_muscle or self.transmission_type == "site"
    gear = float(model.actuator_gear[model.actuator_outadr[element], 0])
    return [((field,), 1.0 if is_plain or gear == 0.0 else gear) for field in fields]


def servo_target(model: mujoco.MjModel, actuator: int) -> CommandField | None:
  """Return the target of a servo; its bias subtracts its own gain times the length, or times the velocity."""
  is_fixed = model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
  is_affine = model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE
  gain = model.actuator_gainprm[actuator, 0]
  on_length, on_velocity = model.actuator_biasprm[actuator, 1:3]
  if not (is_fixed and is_affine and gain != 0.0):
    return None
  if on_length == -gain:
    return "position_target"
  return "velocity_target" if on_length == 0.0 and on_velocity == -gain else None


def command_fields_of(model: mujoco.MjModel, actuator: int) -> tuple[CommandField, ...]:
  """Return the targets that an actuator of a compiled model takes: one per input, empty if unknown.

  The voltage of a DC motor is its effort target.
  """
  kind, dynamics = mujoco.mjtGain(model.actuator_gaintype[actuator]), mujoco.mjtDyn(model.actuator_dyntype[actuator])
  if kind in (mujoco.mjtGain.mjGAIN_PID, mujoco.mjtGain.mjGAIN_DCMOTOR):
    bits = int(model.actuator_ctrlspec[actuator])
    return tuple(field for field, bit in _CONTROLLER_INPUTS if bits & bit)
  if kind == mujoco.mjtGain.mjGAIN_MUSCLE:
    return ("effort_target",)
  servo = servo_target(model, actuator)
  if dynamics == mujoco.mjtDyn.mjDYN_INTEGRATOR:
    return ("velocity_target",) if servo == "position_target" else ()
  if kind != mujoco.mjtGain.mjGAIN_FIXED or dynamics not in _LINEAR:
    return ()
  if model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE:
    return ("effort_target",)
  return () if servo is None else (servo,)
