"""Simulation options, checked before anything is compiled."""

import functools
import operator
from dataclasses import dataclass, field
from typing import Literal

import mujoco
from mjlab_core import Config, ConfigError, Count, Finite, NonNegative, Positive, PositiveCount, field_problems, unknown

EngineName = Literal["native", "warp"]

# Numbers of the options that are chosen by name.
_CHOICES: dict[str, dict[str, int]] = {
  option: {name.partition("_")[2].lower(): member.value for name, member in members.__members__.items() if "_" in name}
  for option, members in (
    ("integrator", mujoco.mjtIntegrator),
    ("cone", mujoco.mjtCone),
    ("jacobian", mujoco.mjtJacobian),
    ("solver", mujoco.mjtSolver),
    ("disableflags", mujoco.mjtDisableBit),
    ("enableflags", mujoco.mjtEnableBit),
  )
}
_FLAGS = ("disableflags", "enableflags")


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
  """Physics options and buffer sizes. `None` keeps the option of the model."""

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
  """Contacts per world on MuJoCo Warp, on average over worlds: the pool is shared. `auto` begins with a size that
  follows from the model, and grows when demand comes near."""
  njmax: PositiveCount | Literal["auto"] = "auto"
  """Constraint rows of each world on MuJoCo Warp. `auto` likewise."""
  broadphase: Literal["nxn", "sap_tile"] | None = None
  """Search for pairs of geoms on MuJoCo Warp: all pairs, or sweep and prune. None lets MuJoCo Warp choose, and tests
  groups of geoms first where a robot is among hundreds of geoms that stay in place."""
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
      ConfigError: the native engine was asked for on a GPU.
    """
    if self.engine == "native" and device_type != "cpu":
      raise ConfigError(
        f"engine 'native' runs on a CPU, the device is '{device_type}'; set device 'cpu' or engine 'auto'"
      )
    if self.engine != "auto":
      return self.engine
    return "native" if device_type == "cpu" else "warp"

  def validate(self) -> None:
    """Refuse options that are misspelt or out of range, all problems in one message.

    Raises:
      ConfigError: naming every such option with its limits.
    """
    problems = [*field_problems(self), *(f"nan_guard.{problem}" for problem in field_problems(self.nan_guard))]
    for option in _FLAGS:
      known = _CHOICES[option]
      problems += [unknown(option, flag, known) for flag in getattr(self, option) if flag not in known]
    if problems:
      raise ConfigError(*(f"SimulationCfg: {problem}" for problem in problems))

  def apply(self, spec: mujoco.MjSpec) -> None:
    """Write the options that are set over those of `spec`."""
    for name, value in vars(self).items():
      if value is None or not hasattr(spec.option, name):
        continue
      if name in _FLAGS:
        value = functools.reduce(operator.or_, (_CHOICES[name][flag] for flag in value), getattr(spec.option, name))
      setattr(spec.option, name, _CHOICES[name][value] if isinstance(value, str) else value)
