"""MuJoCo's general actuator: gain, bias and activation as written."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import mujoco
from mjlab_core import Ascending, Items, Limits

from mjlab_actuators.actuator import CommandField
from mjlab_actuators.actuator_cfg import CtrlInput, Gear
from mjlab_actuators.models.native import NativeActuatorCfg

Dynamics = Literal["none", "integrator", "filter", "filterexact"]
Gain = Literal["fixed", "affine"]
Bias = Literal["none", "affine"]
Range = Annotated[tuple[float, float] | None, Limits(finite=False), Ascending(strict=True)]
Numbers = Annotated[tuple[float, ...], Limits(), Items(ge=0, le=3)]


@dataclass(kw_only=True)
class NativeGeneralActuatorCfg(NativeActuatorCfg):
  """MuJoCo's general actuator: force = gain(l, l') w + bias(l, l'), all clamped to `force_range`.

  Targets are those of the joint: u is the position or velocity target times the gear, or the effort target over it.
  With l = gear q, the length of the transmission, gain is g0 ("fixed") or g0 + g1 l + g2 l' ("affine"), bias is 0
  ("none") or b0 + b1 l + b2 l' ("affine"), and w is the input u itself ("none") or the activation that integrates or
  low-pass filters u.
  """

  command_field: CommandField
  """The target that is handed over as u."""
  gear: Gear = 1.0
  """Reduction between motor and target: transmission length per position. A negative gear reverses ctrl."""
  gain_type: Gain = "fixed"
  gain_prm: Numbers = (1.0,)
  """g0, g1, g2."""
  bias_type: Bias = "none"
  bias_prm: Numbers = ()
  """b0, b1, b2."""
  dyn_type: Dynamics = "none"
  dyn_prm: Numbers = ()
  """Time constant of the filters [s]."""
  ctrl_range: Range = None
  """Clamp of u; None for none."""
  force_range: Range = None
  """Clamp of the force [N or N m]; None for none."""
  act_range: Range = None
  """Clamp of the activation; None for none."""

  def problems(self, target_names: Sequence[str]) -> Iterator[str]:
    """Yield problems of fields that keep their own constraints."""
    yield from super().problems(target_names)
    _, on_length, on_velocity = _padded(self.bias_prm)[:3]
    if self.gain_prm[:1] == (-on_length,) and on_velocity > 0.0:
      yield (
        f"bias_prm is {self.bias_prm}; beside b1 = -g0, MuJoCo takes a positive b2 for a damping ratio and "
        "replaces it: write the damping itself, negative"
      )
    if self.dyn_type in ("filter", "filterexact") and not _padded(self.dyn_prm)[0] > 0.0:
      yield f"dyn_prm is {self.dyn_prm}; a {self.dyn_type} has a positive time constant"

  def _reads_position(self) -> bool:
    kinds = ((self.gain_type, self.gain_prm), (self.bias_type, self.bias_prm))
    return any(kind == "affine" and _padded(numbers)[1] != 0.0 for kind, numbers in kinds)

  def ctrl_inputs(self, model: mujoco.MjModel, element: int) -> list[CtrlInput]:
    """Return the one input."""
    return [((self.command_field,), self.gear)]

  def _add_elements(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    for (element,) in self._bare_elements(spec, target_names, gear=self.gear):
      element.gaintype = getattr(mujoco.mjtGain, f"mjGAIN_{self.gain_type.upper()}")
      element.biastype = getattr(mujoco.mjtBias, f"mjBIAS_{self.bias_type.upper()}")
      element.dyntype = getattr(mujoco.mjtDyn, f"mjDYN_{self.dyn_type.upper()}")
      element.gainprm = _padded(self.gain_prm)
      element.biasprm = _padded(self.bias_prm)
      element.dynprm = _padded(self.dyn_prm)
      for kind in ("ctrl", "force", "act"):
        if (bounds := getattr(self, f"{kind}_range")) is not None:
          setattr(element, f"{kind}limited", mujoco.mjtLimited.mjLIMITED_TRUE)
          setattr(element, f"{kind}range", bounds)


def _padded(numbers: tuple[float, ...]) -> list[float]:
  """Return as many numbers as MuJoCo keeps."""
  return [*numbers, *([0.0] * (10 - len(numbers)))]
