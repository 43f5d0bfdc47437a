"""Simulation options, checked before anything is compiled."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import mujoco
from mjlab_core.counts import why_no_count
from mjlab_core.names import unknown

from mjlab_sim.errors import SimulationError

EngineName = Literal["native", "warp"]

_INTEGRATORS = {
  "euler": mujoco.mjtIntegrator.mjINT_EULER,
  "rk4": mujoco.mjtIntegrator.mjINT_RK4,
  "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
  "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
}
_CONES = {"pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL, "elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC}
_JACOBIANS = {
  "auto": mujoco.mjtJacobian.mjJAC_AUTO,
  "dense": mujoco.mjtJacobian.mjJAC_DENSE,
  "sparse": mujoco.mjtJacobian.mjJAC_SPARSE,
}
_SOLVERS = {
  "newton": mujoco.mjtSolver.mjSOL_NEWTON,
  "cg": mujoco.mjtSolver.mjSOL_CG,
  "pgs": mujoco.mjtSolver.mjSOL_PGS,
}
_DISABLE = {
  name.removeprefix("mjDSBL_").lower(): value.value for name, value in mujoco.mjtDisableBit.__members__.items()
}
_ENABLE = {name.removeprefix("mjENBL_").lower(): value.value for name, value in mujoco.mjtEnableBit.__members__.items()}

RK4_REFUSED = (
  "a step is split around the control, which RK4 does not allow on MuJoCo Warp; choose 'implicitfast', 'implicit' or"
  " 'euler'"
)
_WARP_REFUSES = {
  "solver 'pgs'": "MuJoCo Warp has Newton and CG only; choose solver 'newton' or 'cg'",
  "integrator 'rk4'": RK4_REFUSED,
}
_WARP_REFUSES_DISABLE = {"autoreset", "midphase"}
_WARP_REFUSES_ENABLE = {"override", "fwdinv", "diagexact", "speculative"}


@dataclass(kw_only=True)
class NanGuardCfg:
  """How much is remembered of worlds that diverge."""

  enabled: bool = True
  buffer_size: int = 8
  """Environment steps kept of every world."""
  max_envs_to_dump: int = 4
  """Worlds in one file; of more that diverge between two reports, the first ones are kept."""
  max_dumps: int = 8
  """Reports, each with a file, that one process makes; worlds that diverge later are still ended and counted."""
  output_dir: str | None = None
  """Folder of the files. None: the folder `nan_dumps` of a training run's directory, and nowhere outside of one."""


@dataclass(kw_only=True)
class SimulationCfg:
  """Physics options and buffer sizes. `None` keeps what the model itself says."""

  timestep: float | None = None
  """Duration of one physics step [s]."""
  integrator: Literal["euler", "rk4", "implicit", "implicitfast"] | None = "implicitfast"
  solver: Literal["newton", "cg", "pgs"] | None = None
  cone: Literal["pyramidal", "elliptic"] | None = None
  jacobian: Literal["auto", "dense", "sparse"] | None = None
  iterations: int | None = None
  """Upper bound of solver iterations."""
  ls_iterations: int | None = None
  """Upper bound of line-search iterations."""
  ccd_iterations: int | None = None
  tolerance: float | None = None
  ls_tolerance: float | None = None
  impratio: float | None = None
  """Ratio of frictional to normal constraint impedance."""
  gravity: tuple[float, float, float] | None = None
  """World frame [m/s^2]."""
  disableflags: tuple[str, ...] = ()
  """Names of `mjtDisableBit`, lower case without prefix, added to those of the model."""
  enableflags: tuple[str, ...] = ()
  """Names of `mjtEnableBit`, likewise."""

  nconmax: int | None = None
  """Contacts per world on MuJoCo Warp, on average over worlds: the pool is shared. None lets MuJoCo Warp guess."""
  njmax: int | None = None
  """Constraint rows of each world on MuJoCo Warp. None lets MuJoCo Warp guess."""
  contact_sensor_maxmatch: int = 64
  """Contacts that one contact sensor can match on MuJoCo Warp."""

  engine: Literal["auto", "native", "warp"] = "auto"
  """`auto`: MuJoCo Warp on a GPU, MuJoCo's own batch engine on a CPU."""
  capture: bool = True
  """Record steps as graphs and replay them. Off runs the same code eagerly, for debugging."""
  num_threads: int = 0
  """Threads of the native engine; 0 takes one per CPU."""
  nan_guard: NanGuardCfg = field(default_factory=NanGuardCfg)

  def engine_for(self, device_type: str) -> EngineName:
    """The engine that runs on a device of this type ("cpu" or "cuda").

    Raises:
      SimulationError: the native engine was asked for on a GPU, or one that does not exist.
    """
    if self.engine not in ("auto", "native", "warp"):
      raise SimulationError(f"SimulationCfg: {unknown('engine', str(self.engine), ['auto', 'native', 'warp'])}")
    if self.engine == "native" and device_type != "cpu":
      raise SimulationError(
        f"engine 'native' runs on a CPU, the device is '{device_type}'; set device 'cpu' or engine 'auto'"
      )
    if self.engine != "auto":
      return self.engine
    return "native" if device_type == "cpu" else "warp"

  def validate(self, engine: EngineName) -> None:
    """Refuse what is misspelt, out of range, or beyond `engine`, all problems in one message.

    Raises:
      SimulationError: naming every option that cannot be served and what would work.
    """
    problems: list[str] = []
    for name in ("timestep", "impratio"):
      value = getattr(self, name)
      if value is not None and not 0 < value < math.inf:
        problems.append(f"{name} must be {'positive' if not value > 0 else 'finite'}, got {value}")
    for name in ("iterations", "ls_iterations", "ccd_iterations", "nconmax", "njmax", "contact_sensor_maxmatch"):
      value = getattr(self, name)
      if value is not None and (wrong := why_no_count(value, 1)):
        problems.append(f"{name} {wrong}")
    for name in ("tolerance", "ls_tolerance"):
      value = getattr(self, name)
      if value is not None and not value >= 0:
        problems.append(f"{name} must not be negative, got {value}")
    if self.gravity is not None and not (
      isinstance(self.gravity, Sequence) and len(self.gravity) == 3 and all(map(math.isfinite, self.gravity))
    ):
      problems.append(f"gravity must be three finite numbers, got {self.gravity}")
    if wrong := why_no_count(self.num_threads):
      problems.append(f"num_threads {wrong}")
    for name in ("buffer_size", "max_envs_to_dump", "max_dumps"):
      if wrong := why_no_count(getattr(self.nan_guard, name), 1):
        problems.append(f"nan_guard.{name} {wrong}")
    for name, table in (
      ("integrator", _INTEGRATORS),
      ("solver", _SOLVERS),
      ("cone", _CONES),
      ("jacobian", _JACOBIANS),
    ):
      value = getattr(self, name)
      if value is not None and value not in table:
        problems.append(unknown(name, value, list(table)))
    for flags, table, kind in (
      (self.disableflags, _DISABLE, "disable flag"),
      (self.enableflags, _ENABLE, "enable flag"),
    ):
      problems.extend(unknown(kind, flag, list(table)) for flag in flags if flag not in table)
    if engine == "warp":
      for given, reason in _WARP_REFUSES.items():
        option, value = given.split(" ")
        if getattr(self, option) == value.strip("'"):
          problems.append(f"{given}: {reason}")
      for flag in sorted(_WARP_REFUSES_DISABLE & set(self.disableflags)):
        problems.append(f"disable flag '{flag}' does not exist on MuJoCo Warp")
      for flag in sorted(_WARP_REFUSES_ENABLE & set(self.enableflags)):
        problems.append(f"enable flag '{flag}' does not exist on MuJoCo Warp")
    if problems:
      raise SimulationError("SimulationCfg: " + "; ".join(problems))

  def apply(self, spec: mujoco.MjSpec) -> None:
    """Write the options that are set over those of `spec`."""
    option = spec.option
    for name in (
      "timestep",
      "iterations",
      "ls_iterations",
      "ccd_iterations",
      "tolerance",
      "ls_tolerance",
      "impratio",
      "gravity",
    ):
      value = getattr(self, name)
      if value is not None:
        setattr(option, name, value)
    for name, table in (
      ("integrator", _INTEGRATORS),
      ("solver", _SOLVERS),
      ("cone", _CONES),
      ("jacobian", _JACOBIANS),
    ):
      value = getattr(self, name)
      if value is not None:
        setattr(option, name, table[value])
    for flag in self.disableflags:
      option.disableflags |= _DISABLE[flag]
    for flag in self.enableflags:
      option.enableflags |= _ENABLE[flag]
