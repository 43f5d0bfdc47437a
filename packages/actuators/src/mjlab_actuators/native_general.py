"""MuJoCo's general actuator: gain, bias and activation as written."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import mujoco
from mjlab_core.names import unknown

from mjlab_actuators.actuator import ActuatorGroup
from mjlab_actuators.command import COMMAND_FIELDS, CommandField
from mjlab_actuators.native import NativeActuatorCfg

Dynamics = Literal["none", "integrator", "filter", "filterexact"]
Gain = Literal["fixed", "affine"]
Bias = Literal["none", "affine"]


@dataclass(kw_only=True)
class NativeGeneralActuatorCfg(NativeActuatorCfg):
  """MuJoCo's general actuator: force = gain(l, l') w + bias(l, l'), all clamped to `force_range`.

  With l = gear q, the length of the transmission, gain is g0 ("fixed") or g0 + g1 l + g2 l' ("affine"), bias is 0
  ("none") or b0 + b1 l + b2 l' ("affine"), and w is the input u itself ("none") or the activation that integrates or
  low-pass filters u.
  """

  command_field: CommandField
  """The set-point that is handed over as u."""
  gain_type: Gain = "fixed"
  gain_prm: tuple[float, ...] = (1.0,)
  """g0, g1, g2."""
  bias_type: Bias = "none"
  bias_prm: tuple[float, ...] = ()
  """b0, b1, b2."""
  dyn_type: Dynamics = "none"
  dyn_prm: tuple[float, ...] = ()
  """Time constant of the filters [s]."""
  gear: float = 1.0
  """Transmission length per position of the target."""
  ctrl_range: tuple[float, float] | None = None
  """Clamp of u; None for none."""
  force_range: tuple[float, float] | None = None
  """Clamp of the force [N or N m]; None for none."""
  act_range: tuple[float, float] | None = None
  """Clamp of the activation; None for none."""

  def validate(self, target_names: Sequence[str]) -> None:
    super().validate(target_names)
    kind = type(self).__name__
    choices: dict[str, Sequence[str]] = {
      "command_field": COMMAND_FIELDS,
      "gain_type": get_args(Gain),
      "bias_type": get_args(Bias),
      "dyn_type": get_args(Dynamics),
    }
    for name, allowed in choices.items():
      if getattr(self, name) not in allowed:
        raise ValueError(unknown(name, getattr(self, name), allowed, owner=kind))
    for name in ("gain_prm", "bias_prm", "dyn_prm"):
      numbers = getattr(self, name)
      if len(numbers) > 3 or not all(math.isfinite(number) for number in numbers):
        raise ValueError(f"{kind}: {name} is {numbers}; it must be up to three finite numbers")
    gain, (_, on_length, on_velocity) = self.gain_prm[:1], _padded(self.bias_prm)[:3]
    if gain == (-on_length,) and on_velocity > 0.0:
      raise ValueError(
        f"{kind}: bias_prm is {self.bias_prm}; beside b1 = -g0, MuJoCo takes a positive b2 for a damping ratio and "
        "replaces it: write the damping itself, negative"
      )
    if self.dyn_type in ("filter", "filterexact") and not (self.dyn_prm and self.dyn_prm[0] > 0.0):
      raise ValueError(f"{kind}: dyn_prm is {self.dyn_prm}; a {self.dyn_type} has a positive time constant")
    self._check_gear(self.gear)
    if self.act_range is not None and self.dyn_type == "none":
      raise ValueError(f"{kind}: act_range is given, but dyn_type 'none' has no activation")
    for name in ("ctrl_range", "force_range", "act_range"):
      limits = getattr(self, name)
      if limits is not None and not limits[0] < limits[1]:
        raise ValueError(f"{kind}: {name} is {limits}; the first must be less than the second")

  def _reads_position(self) -> bool:
    kinds = ((self.gain_type, self.gain_prm), (self.bias_type, self.bias_prm))
    return any(kind == "affine" and _padded(numbers)[1] != 0.0 for kind, numbers in kinds)

  def _group(self, target_names: Sequence[str], ctrl_ids: Sequence[int]) -> ActuatorGroup:
    return replace(super()._group(target_names, ctrl_ids), command_fields=(self.command_field,))

  def _add_elements(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    limited = mujoco.mjtLimited.mjLIMITED_TRUE
    for element in self._bare_elements(spec, target_names, self.gear):
      element.gaintype = getattr(mujoco.mjtGain, f"mjGAIN_{self.gain_type.upper()}")
      element.biastype = getattr(mujoco.mjtBias, f"mjBIAS_{self.bias_type.upper()}")
      element.dyntype = getattr(mujoco.mjtDyn, f"mjDYN_{self.dyn_type.upper()}")
      element.gainprm = _padded(self.gain_prm)
      element.biasprm = _padded(self.bias_prm)
      element.dynprm = _padded(self.dyn_prm)
      if self.ctrl_range is not None:
        element.ctrllimited, element.ctrlrange = limited, list(self.ctrl_range)
      if self.force_range is not None:
        element.forcelimited, element.forcerange = limited, list(self.force_range)
      if self.act_range is not None:
        element.actlimited, element.actrange = limited, list(self.act_range)


def _padded(numbers: tuple[float, ...]) -> list[float]:
  """As many numbers as MuJoCo keeps."""
  return [*numbers, *([0.0] * (10 - len(numbers)))]
