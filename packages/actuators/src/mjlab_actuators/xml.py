"""Actuators that the MJCF declares itself, kept exactly as they are written."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import mujoco
from mjlab_core.names import match_names

from mjlab_actuators.actuator import Actuator, ActuatorGroup
from mjlab_actuators.actuator_cfg import ActuatorCfg
from mjlab_actuators.command import CommandField
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
  """Drives the actuators that the MJCF declares on joints, tendons or sites; adds and changes nothing on them.

  Which set-point an actuator takes is read from its gain, bias and dynamics. Patterns match names of joints (tendons,
  sites) that have an actuator in the MJCF; every actuator of such a target is driven. The MJCF says where the wrench of
  a site points.
  """

  command_field: CommandField | None = None
  """The set-point to hand over, for all; None reads it from each actuator."""

  @property
  def law(self) -> type[Actuator]:
    return PassThrough

  def match(self, candidates: Sequence[str], owner: str = "", actuated: Sequence[str] | None = None) -> list[str]:
    """What is driven among `candidates`; with `actuated`, only what has an actuator can match."""
    if actuated is not None:
      candidates = [name for name in candidates if name in actuated]
    self._check_transmission()
    what = f"{self.transmission_type} with an MJCF actuator"
    return match_names(self.target_names_expr, candidates, what=what, owner=owner)[1]

  def _validate_site(self, kind: str, target_names: Sequence[str]) -> None:
    for name in ("site_gear", "refsite"):
      if getattr(self, name) is not None:
        raise ValueError(f"{kind}: {name} is given, but the MJCF says it already")

  def _add_elements(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    pass

  def _group(self, target_names: Sequence[str], ctrl_ids: Sequence[int]) -> ActuatorGroup:
    if self.command_field is None:
      raise ValueError("XmlActuatorCfg: without a model, command_field must say which set-point is handed over")
    return replace(super()._group(target_names, ctrl_ids), command_fields=(self.command_field,))

  def groups(
    self,
    model: mujoco.MjModel,
    target_names: Sequence[str],
    prefix: str = "",
    without: Collection[int] = (),
  ) -> list[ActuatorGroup]:
    """One group per kind of set-point among the actuators of these targets, those with an id in `without` left out.

    Raises:
      ValueError: A target has no actuator, the set-point of one cannot be told and `command_field` does not say, or two
        on one site would get the same set-point for wrenches of their own.
    """
    found: dict[CommandField, tuple[list[Target], list[int]]] = {}
    for name in target_names:
      target = Target(self.transmission_type, name)
      elements = [index for index in actuators_of(model, target, prefix) if index not in without]
      if not elements:
        raise ValueError(f"XmlActuatorCfg: {target.transmission} {prefix + name!r} has no actuator in the MJCF")
      for element in elements:
        first = int(model.actuator_ctrladr[element])
        for offset, field in enumerate(self._fields(model, element)):
          targets, ids = found.setdefault(field, ([], []))
          if target.transmission == "site" and target in targets:
            raise ValueError(
              f"XmlActuatorCfg: site {prefix + name!r} has one {field}, but several actuators that take one; give each "
              "a site of its own, or leave the site out and write its ctrl"
            )
          targets.append(target)
          ids.append(first + offset)
    return [
      ActuatorGroup(
        law=PassThrough,
        targets=tuple(targets),
        command_fields=(field,),
        parameters={},
        delay=self.delay,
        ctrl_ids=tuple(ids),
      )
      for field, (targets, ids) in found.items()
    ]

  def _fields(self, model: mujoco.MjModel, actuator: int) -> tuple[CommandField, ...]:
    width = int(model.actuator_ctrlnum[actuator])
    fields = (self.command_field,) if self.command_field is not None else command_fields_of(model, actuator)
    if len(fields) != width:
      name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, actuator)
      raise ValueError(
        f"XmlActuatorCfg: cannot tell which set-point actuator {name!r} takes ({width} inputs, "
        f"recognised: {', '.join(fields) or 'none'}); set command_field, or leave the actuator out"
      )
    return fields


def command_fields_of(model: mujoco.MjModel, actuator: int) -> tuple[CommandField, ...]:
  """The set-points that an actuator of a compiled model takes, one per input; empty when they cannot be told.

  A servo is told from a torque source by its bias: a position servo subtracts its own gain times the length, a velocity
  servo its own gain times the velocity. The voltage of a DC motor is its effort target.
  """
  kind = mujoco.mjtGain(model.actuator_gaintype[actuator])
  bias = mujoco.mjtBias(model.actuator_biastype[actuator])
  dynamics = mujoco.mjtDyn(model.actuator_dyntype[actuator])
  gain = float(model.actuator_gainprm[actuator, 0])
  on_length, on_velocity = (float(value) for value in model.actuator_biasprm[actuator, 1:3])
  if kind in (mujoco.mjtGain.mjGAIN_PID, mujoco.mjtGain.mjGAIN_DCMOTOR):
    spec = int(model.actuator_ctrlspec[actuator])
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


def targets_with_actuator(
  model: mujoco.MjModel, transmission: Transmission, prefix: str = "", without: Collection[int] = ()
) -> list[str]:
  """Names of what an actuator drives whose id is not in `without`, prefix removed, in model order."""
  return [
    name
    for name in targets_of(model, transmission, prefix)
    if any(index not in without for index in actuators_of(model, Target(transmission, name), prefix))
  ]
