"""MuJoCo's muscle: activation dynamics, and force by length and velocity."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import mujoco

from mjlab_actuators.actuator_cfg import PerTarget
from mjlab_actuators.command import CommandField
from mjlab_actuators.native import NativeActuatorCfg
from mjlab_actuators.transmission import Target, range_of


@dataclass(kw_only=True)
class NativeMuscleActuatorCfg(NativeActuatorCfg):
  """MuJoCo's muscle, u = effort target, clamped to [0, 1].

  force = -F0 (FL(l) FV(v) act + FP(l)): the muscle pulls, so its sense is against a positive gear. The activation act
  follows u with the time constants, and lives in the simulation's `act`; the curves FL, FV, FP are those of MuJoCo's
  documentation, "Muscles". Length l is in units of the optimal fibre length: `length_range` is mapped to `range`.
  """

  length_range: tuple[float, float] | None = None
  """Least and greatest length of the transmission, that is gear times joint position [m or rad]; None takes the range
  of the joint or tendon, which must then be limited."""
  gear: float = 1.0
  """Moment arm: transmission length per position of the target."""
  force: PerTarget | None = None
  """Peak active force at rest F0 [N]; None makes it `scale` over the acceleration that unit force causes at qpos0."""
  scale: float = 200.0
  """Strength of a muscle without `force`."""
  time_constants: tuple[float, float] = (0.01, 0.04)
  """Of activation and deactivation [s]."""
  smoothing: float = 0.0
  """Width of the blend between the two time constants."""
  range: tuple[float, float] = (0.75, 1.05)
  """Operating lengths at the two ends of `length_range` [optimal lengths]."""
  lmin: float = 0.5
  """Least length with active force [optimal lengths]."""
  lmax: float = 1.6
  """Greatest length with active force [optimal lengths]."""
  vmax: float = 1.5
  """Shortening velocity at which active force vanishes [optimal lengths/s]."""
  fpmax: float = 1.3
  """Passive force at lmax [F0]."""
  fvmax: float = 1.2
  """Active force at saturating lengthening velocity [F0]."""

  command_fields: ClassVar[tuple[CommandField, ...]] = ("effort_target",)

  def validate(self, target_names: Sequence[str]) -> None:
    super().validate(target_names)
    kind = type(self).__name__
    self._check_gear(self.gear)
    if self.force is not None:
      self._positives("force", target_names)
    if self.smoothing < 0.0 or min(self.time_constants) <= 0.0:
      raise ValueError(
        f"{kind}: time_constants is {self.time_constants} and smoothing {self.smoothing}; the former must be positive, "
        "the latter not negative"
      )
    for name in ("scale", "vmax", "fpmax", "fvmax"):
      if not getattr(self, name) > 0.0:
        raise ValueError(f"{kind}: {name} is {getattr(self, name)}; it must be positive")
    for name, (low, high) in {
      "length_range": self.length_range or (0.0, 1.0),
      "range": self.range,
      "lmin, lmax": (self.lmin, self.lmax),
    }.items():
      if not low < high:
        raise ValueError(f"{kind}: {name} is ({low}, {high}); the first must be less than the second")

  def _reads_position(self) -> bool:
    return True

  def _add_elements(self, spec: mujoco.MjSpec, target_names: Sequence[str]) -> None:
    forces = (-1.0,) * len(target_names) if self.force is None else self._positives("force", target_names)
    elements = self._bare_elements(spec, target_names, self.gear)
    for name, element, force in zip(target_names, elements, forces, strict=True):
      element.set_to_muscle(
        timeconst=list(self.time_constants),
        tausmooth=self.smoothing,
        range=list(self.range),
        force=force,
        scale=self.scale,
        lmin=self.lmin,
        lmax=self.lmax,
        vmax=self.vmax,
        fpmax=self.fpmax,
        fvmax=self.fvmax,
      )
      element.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
      element.ctrlrange = [0.0, 1.0]
      element.lengthrange = sorted(self._length_range(spec, name))

  def _length_range(self, spec: mujoco.MjSpec, name: str) -> tuple[float, float]:
    if self.length_range is not None:
      return self.length_range
    low, high = range_of(spec, Target(self.transmission_type, name))
    if not low < high:
      raise ValueError(
        f"{type(self).__name__}: {self.transmission_type} {name!r} is not limited, so length_range must be given"
      )
    return self.gear * low, self.gear * high
