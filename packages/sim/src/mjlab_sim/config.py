"""Simulation options, checked before anything is compiled."""

from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import mujoco
from mjlab_core import (
  ConfigError,
  Count,
  Finite,
  NonNegative,
  Positive,
  PositiveCount,
  check_name,
  field_problems,
  unknown,
)
from mjlab_core.config import Config

EngineName = Literal["native", "warp"]

_CHOICES: dict[str, dict[str, Any]] = {
  "integrator": {
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
    "rk4": mujoco.mjtIntegrator.mjINT_RK4,
    "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
  },
  "cone": {"pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL, "elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC},
  "jacobian": {
    "auto": mujoco.mjtJacobian.mjJAC_AUTO,
    "dense": mujoco.mjtJacobian.mjJAC_DENSE,
    "sparse": mujoco.mjtJacobian.mjJAC_SPARSE,
  },
  "solver": {
    "newton": mujoco.mjtSolver.mjSOL_NEWTON,
    "cg": mujoco.mjtSolver.mjSOL_CG,
    "pgs": mujoco.mjtSolver.mjSOL_PGS,
  },
}
_NUMBERS = "timestep iterations ls_iterations ccd_iterations tolerance ls_tolerance impratio gravity".split()
_FLAGS: dict[str, dict[str, int]] = {
  f"{kind}flags": {name.removeprefix(prefix).lower(): bit.value for name, bit in bits.__members__.items()}
  for kind, prefix, bits in (
    ("disable", "mjDSBL_", mujoco.mjtDisableBit),
    ("enable", "mjENBL_", mujoco.mjtEnableBit),
  )
}

RK4_REFUSED = (
  "a step is split around the control, which RK4 does not allow on MuJoCo Warp; choose 'implicitfast', 'implicit' or"
  " 'euler'"
)
_WARP_REFUSES = {
  ("solver", "pgs"): "MuJoCo Warp has Newton and CG only; choose solver 'newton' or 'cg'",
  ("integrator", "rk4"): RK4_REFUSED,
}
_WARP_LACKS = {
  "disableflags": ("autoreset", "midphase"),
  "enableflags": ("diagexact", "fwdinv", "override", "speculative"),
}


@dataclass(kw_only=True)
class NanGuardCfg(Config):
  """Memory of worlds that diverge."""

  enabled: bool = True
  buffer_size: PositiveCount = 8
  """Environment steps kept of every world."""
  max_envs_to_dump: PositiveCount = 4
  """Worlds in one file; of more that diverge between two reports, the first ones are kept."""
  max_dumps: PositiveCount = 8
  """Reports, each with a file, that one process makes; worlds that diverge later are still ended and counted."""
  output_dir: str | None = None
  """Folder of the files. None: the folder `nan_dumps` of a training run's directory, and nowhere outside of one."""


@dataclass(kw_only=True)
class SimulationCfg(Config):
  """Physics options and buffer sizes. `None` keeps what the model itself says."""

  timestep: Positive | None = None
  """Duration of one physics step [s]."""
  integrator: Literal["euler", "rk4", "implicit", "implicitfast"] | None = "implicitfast"
  solver: Literal["newton", "cg", "pgs"] | None = None
  solver_backend: Literal["auto", "mujoco_warp", "fused"] = "auto"
  """Program that runs Newton's method on MuJoCo Warp. `fused`: one kernel for all iterations of a world, which refuses
  some models by name. `auto`: fused on a GPU where the model allows it, and MuJoCo Warp's own elsewhere."""
  cone: Literal["pyramidal", "elliptic"] | None = None
  jacobian: Literal["auto", "dense", "sparse"] | None = None
  iterations: PositiveCount | None = None
  """Upper bound of solver iterations."""
  ls_iterations: PositiveCount | None = None
  """Upper bound of line-search iterations."""
  ccd_iterations: PositiveCount | None = None
  tolerance: NonNegative | None = None
  ls_tolerance: NonNegative | None = None
  impratio: Positive | None = None
  """Ratio of frictional to normal constraint impedance."""
  gravity: tuple[Finite, Finite, Finite] | None = None
  """World frame [m/s^2]."""
  disableflags: tuple[str, ...] = ()
  """Names of `mjtDisableBit`, lower case without prefix, added to those of the model."""
  enableflags: tuple[str, ...] = ()
  """Names of `mjtEnableBit`, likewise."""

  nconmax: PositiveCount | Literal["auto"] = "auto"
  """Contacts per world on MuJoCo Warp, on average over worlds: the pool is shared. `auto` begins with what the model
  suggests, and grows when demand comes near."""
  njmax: PositiveCount | Literal["auto"] = "auto"
  """Constraint rows of each world on MuJoCo Warp. `auto` likewise."""
  broadphase: Literal["nxn", "sap_tile"] | None = None
  """Search for pairs of geoms on MuJoCo Warp: all pairs, or sweep and prune. None lets MuJoCo Warp choose."""
  broadphase_filter: tuple[Literal["plane", "sphere", "aabb", "obb"], ...] | None = None
  """Tests that a pair must pass on MuJoCo Warp. None lets MuJoCo Warp choose."""
  contact_sensor_maxmatch: PositiveCount = 64
  """Contacts that one contact sensor can match on MuJoCo Warp."""

  engine: Literal["auto", "native", "warp"] = "auto"
  """`auto`: MuJoCo Warp on a GPU, MuJoCo's own batch engine on a CPU."""
  capture: bool = True
  """Record steps as graphs and replay them. Off runs the same code eagerly, for debugging."""
  num_threads: Count = 0
  """Threads of the native engine; 0 takes one per CPU."""
  nan_guard: NanGuardCfg = field(default_factory=NanGuardCfg)

  def engine_for(self, device_type: str) -> EngineName:
    """Return the engine that runs on a device of this type ("cpu" or "cuda").

    Raises:
      ConfigError: the native engine was asked for on a GPU, or one that does not exist.
    """
    check_name("engine", str(self.engine), ("auto", *get_args(EngineName)), "SimulationCfg")
    if self.engine == "native" and device_type != "cpu":
      raise ConfigError(
        f"engine 'native' runs on a CPU, the device is '{device_type}'; set device 'cpu' or engine 'auto'"
      )
    if self.engine != "auto":
      return self.engine
    return "native" if device_type == "cpu" else "warp"

  def validate(self, engine: EngineName) -> None:
    """Refuse what is misspelt, out of range, or beyond `engine`, all problems in one message.

    Raises:
      ConfigError: naming every option that cannot be served and what would work.
    """
    problems = [*field_problems(self), *(f"nan_guard.{problem}" for problem in field_problems(self.nan_guard))]
    for field_name, known in _FLAGS.items():
      given = getattr(self, field_name)
      kind = f"{field_name.removesuffix('flags')} flag"
      problems += [unknown(kind, flag, known) for flag in given if flag not in known]
      if engine == "warp":
        lacking = [flag for flag in _WARP_LACKS[field_name] if flag in given]
        problems += [f"{kind} '{flag}' does not exist on MuJoCo Warp" for flag in lacking]
    if engine == "warp":
      refused = [(choice, reason) for choice, reason in _WARP_REFUSES.items() if getattr(self, choice[0]) == choice[1]]
      problems += [f"{name} '{value}': {reason}" for (name, value), reason in refused]
    if problems:
      raise ConfigError(*(f"SimulationCfg: {problem}" for problem in problems))

  def apply(self, spec: mujoco.MjSpec) -> None:
    """Write the options that are set over those of `spec`."""
    option = spec.option
    for name in (*_NUMBERS, *_CHOICES):
      value = getattr(self, name)
      if value is not None:
        setattr(option, name, _CHOICES[name][value] if name in _CHOICES else value)
    for name, bits in _FLAGS.items():
      for flag in getattr(self, name):
        setattr(option, name, getattr(option, name) | bits[flag])
