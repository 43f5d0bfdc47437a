"""Servo gains and reflected inertia from a motor's data sheet.

Sources: K. Lynch and F. Park, *Modern Robotics*, Cambridge 2017, section 8.9.2 (apparent inertia of a geared rotor);
G. Franklin, J. Powell and A. Emami-Naeini, *Feedback Control of Dynamic Systems*, section 3.3 (second-order response).
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from mjlab_core import MjlabError, NonNegative, check_value


class PdGains(NamedTuple):
  """Gains of a position servo."""

  stiffness: float
  """Position gain kp [N/m or N m/rad]."""
  damping: float
  """Velocity gain kd [N s/m or N m s/rad]."""


def gains_from_frequency(inertia: float, natural_frequency: float, damping_ratio: float) -> PdGains:
  """Return the gains for the wanted poles of J q'' + kd q' + kp q = 0: J wn^2 and 2 zeta J wn (Franklin et al., 3.3).

  Args:
    inertia: J, the inertia that the servo feels at its target [kg or kg m^2].
    natural_frequency: Undamped natural frequency wn / (2 pi) [Hz].
    damping_ratio: zeta; 1 is critically damped, more is sluggish without overshoot.

  Raises:
    MjlabError: An argument is negative or not finite.
  """
  _require_non_negative(inertia=inertia, natural_frequency=natural_frequency, damping_ratio=damping_ratio)
  omega = 2.0 * math.pi * natural_frequency
  return PdGains(inertia * omega**2, 2.0 * damping_ratio * inertia * omega)


def reflected_inertia(rotor_inertia: float, gear_ratio: float) -> float:
  """Return the inertia of a rotor seen behind a reduction, J N^2 [kg m^2]; the MJCF attribute `armature` of a joint.

  The rotor turns N times as fast as the output, and kinetic energy goes with the square (Lynch and Park, 8.9.2).

  Raises:
    MjlabError: An argument is negative or not finite.
  """
  _require_non_negative(rotor_inertia=rotor_inertia, gear_ratio=gear_ratio)
  return rotor_inertia * gear_ratio**2


def reflected_inertia_of_stages(inertias: Sequence[float], gear_ratios: Sequence[float]) -> float:
  """Return the inertia of a chain of rotating parts seen at the output, sum of J_i (N_i ... N_last)^2 [kg m^2].

  `reflected_inertia` of each part with all the reduction that follows it; of a planetary gearbox of two stages
  J1 (N1 N2)^2 + J2 N2^2 + J3.

  Args:
    inertias: Inertia of the rotor and of each stage's own turning parts, motor side first [kg m^2]. One more than there
      are ratios when the last part turns with the output, as in a planetary gearbox.
    gear_ratios: Reduction between one part and the next, motor side first.

  Raises:
    MjlabError: The lengths do not fit, or a number is negative or not finite.
  """
  if len(inertias) not in (len(gear_ratios), len(gear_ratios) + 1):
    raise MjlabError(
      f"{len(inertias)} inertias need {len(inertias)} or {len(inertias) - 1} gear ratios, not {len(gear_ratios)}"
    )
  total = 0.0
  for index, inertia in enumerate(inertias):
    total += reflected_inertia(inertia, math.prod(gear_ratios[index:]))
  return total


def _require_non_negative(**values: float) -> None:
  for name, value in values.items():
    check_value(name, value, NonNegative)
