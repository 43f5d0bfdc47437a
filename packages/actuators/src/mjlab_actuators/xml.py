"""Actuators that the MJCF declares, kept exactly as they are written."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
from mjlab_core import MjlabError

from mjlab_actuators.actuator import CommandField
from mjlab_actuators.actuator_cfg import ActuatorCfg
from mjlab_actuators.native import PassThrough
from mjlab_actuators.native_dc_motor import INPUTS


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

  def ctrl_fields(self, model: mujoco.MjModel, element: int) -> Sequence[tuple[CommandField, ...]]:
    """Return the target of each input of an actuator.

    Raises:
      MjlabError: The kind of target is unknown, and `command_field` is not given.
    """
    width = int(model.actuator_ctrlnum[element])
    fields = (self.command_field,) if self.command_field is not None else command_fields_of(model, element)
    if len(fields) != width:
      raise MjlabError(
        f"XmlActuatorCfg: unknown which target actuator {model.actuator(element).name!r} takes ({width} inputs, "
        f"recognised: {', '.join(fields) or 'none'}); set command_field, or leave the actuator out"
      )
    return [(field,) for field in fields]

  def ctrl_gear(self, model: mujoco.MjModel, element: int) -> float:
    """Return the gear of an actuator: 1 for volts, activations of muscles, and wrenches at sites."""
    kind = mujoco.mjtGain(model.actuator_gaintype[element])
    volts = int(mujoco.mjtCtrlInput.mjINPUT_VOLTAGE)
    is_voltage = kind == mujoco.mjtGain.mjGAIN_DCMOTOR and bool(int(model.actuator_ctrlspec[element]) & volts)
    gear = float(model.actuator_gear[model.actuator_outadr[element], 0])
    is_plain = is_voltage or kind == mujoco.mjtGain.mjGAIN_MUSCLE or self.transmission_type == "site"
    return 1.0 if is_plain or gear == 0.0 else gear


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
