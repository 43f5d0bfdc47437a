"""MuJoCo's muscle: activation dynamics, and force by length and velocity."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

import mujoco
from mjlab_core import Ascending, Limits, MjlabError, NonNegative, Positive

from mjlab_actuators.actuator import CommandField
from mjlab_actuators.actuator_cfg import Gear, PerTarget
from mjlab_actuators.models.native import NativeActuatorCfg
from mjlab_actuators.transmission import Target, range_of


@dataclass(kw_only=True)
class NativeMuscleActuatorCfg(NativeActuatorCfg):
  """MuJoCo's muscle, u = effort target, clamped to [0, 1].

  force = -F0 (FL(l) FV(v) act + FP(l)): the muscle pulls, so its sense is against a positive gear. The activation act
  follows u with the time constants, and lives in the simulation's `act`; the curves FL, FV, FP are those of MuJoCo's
  documentation, "Muscles". Length l is in units of the optimal fibre length: `length_range` is mapped to `range`.
  """

  gear: Gear = 1.0
  """Transmission length per position; a negative gear reverses the pull. Activations pass unchanged."""
  length_range: Annotated[tuple[float, float] | None, Ascending(strict=True)] = None
  """Least and greatest length of the transmission, that is gear times joint position [m or rad]; None takes the range
  of the joint or tendon, which must then be limited."""
  force: Annotated[PerTarget | None, Limits(gt=0)] = None
  """Peak active force at rest F0 [N]; None makes it `scale` over the acceleration that unit force causes at qpos0."""
  scale: Positive = 200.0
  """Strength of a muscle without `force`."""
  time_constants: Annotated[tuple[float, float], Limits(gt=0)] = (0.01, 0.04)
  """Time constants of activation and deactivation [s]."""
  smoothing: NonNegative = 0.0
  """Width of the blend between the two time constants."""
  range: Annotated[tuple[float, float], Ascending(strict=True)] = (0.75, 1.05)
  """Operating lengths at the two ends of `length_range` [optimal lengths]."""
  lmin: float = 0.5
  """Least length with active force [optimal lengths]."""
  lmax: float = 1.6
  """Greatest length with active force [optimal lengths]."""
  vmax: Positive = 1.5
  """Shortening velocity at which active force vanishes [optimal lengths/s]."""
  fpmax: Positive = 1.3
  """Passive force at lmax [F0]."""
  fvmax: Positive = 1.2
  """Active force at saturating lengthening velocity [F0]."""

  command_fields: ClassVar[tuple[CommandField, ...]] = ("effort_target",)

  def problems(self, target_names: Sequence[str]) -> Iterator[str]:
    """Yield problems of fields that keep their own constraints."""
    yield from super().problems(target_names)
    if not self.lmin < self.lmax:
      yield f"lmin {self.lmin} must be below lmax {self.lmax}"

  def _reads_position(self) -> bool:
    return True

  def _add_elements(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    for element, force in self._bare_elements(spec, target_names, "force", gear=self.gear):
      element.set_to_muscle(
        timeconst=list(self.time_constants),
        tausmooth=self.smoothing,
        range=list(self.range),
        force=force if math.isfinite(force) else -1.0,
        scale=self.scale,
        lmin=self.lmin,
        lmax=self.lmax,
        vmax=self.vmax,
        fpmax=self.fpmax,
        fvmax=self.fvmax,
      )
      element.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
      element.ctrlrange = [0.0, 1.0]
      element.lengthrange = sorted(self._length_range(spec, element.target))

  def _length_range(self, spec: mujoco.MjSpec, name: str) -> tuple[float, float]:
    if self.length_range is not None:
      return self.length_range
    low, high = range_of(spec, Target(self.transmission_type, name))
    if not low < high:
      raise MjlabError(
        f"{type(self).__name__}: {self.transmission_type} {name!r} is not limited, so length_range must be given"
      )
    return self.gear * low, self.gear * high
