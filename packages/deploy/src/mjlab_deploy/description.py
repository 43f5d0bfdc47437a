"""Contents of `bundle.json`."""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

FORMAT = 1
"""Version that this package writes, and the newest that it reads."""
EPISODE_START = "episode_start"
"""Input of a graph with memory: 1 in the first step of an episode, else 0."""
LAST_ACTION = "memory/last_action"
"""Input: the raw action of the step before."""
ACTION = "action"
"""Output: the raw action of the network."""

Numbers = tuple[float, ...]
Range = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Joint:
  """Joint of the robot; a gain or a limit that the training did not have is None."""

  name: str
  default_position: float
  """Position in the default pose [rad, m]."""
  is_driven: bool
  """True if the policy sets a target of this joint."""
  stiffness: float | None = None
  """kp of the servo [N m/rad, N/m]."""
  damping: float | None = None
  """kd of the servo [N m s/rad, N s/m]."""
  armature: float = 0.0
  """Inertia of rotor and gears at the joint [kg m^2, kg]."""
  effort_limit: float | None = None
  """Largest effort [N m, N]."""
  velocity_limit: float | None = None
  """Top speed [rad/s, m/s]."""
  position_range: Range | None = None
  """Mechanical limits [rad, m]."""


@dataclass(frozen=True, kw_only=True)
class Robot:
  """Robot that the policy drives."""

  name: str
  """Name of the entity, which precedes its elements in `scene.xml`: "robot/"."""
  joints: tuple[Joint, ...]
  """Joints in the order of "joint/position" and "joint/velocity"."""
  root_body: str
  """Root of the kinematic tree."""
  is_floating: bool
  """True if the root moves freely."""
  actuator_model: Literal["position_servo", "other"] = "position_servo"
  """"position_servo": effort = clamp(kp (target - q) - kd q'), which MuJoCo and a robot's drives compute."""
  delay_range: tuple[int, int] = (0, 0)
  """Delays of targets that the training drew [physics steps]; not part of the graph."""

  @property
  def joint_names(self) -> tuple[str, ...]:
    """Names of the joints in their order."""
    return tuple(joint.name for joint in self.joints)

  def values(self, field: str, missing: float = 0.0) -> np.ndarray:
    """Return a number of each joint, `missing` where it is None, (joints,)."""
    found = [getattr(joint, field) for joint in self.joints]
    return np.array([missing if value is None else value for value in found], dtype=float)


@dataclass(frozen=True, kw_only=True)
class Timing:
  """Rates of control and physics."""

  physics_dt: float
  """Time step of the training's physics [s]."""
  decimation: int
  """Physics steps per step of the policy."""
  episode_steps: int
  """Length of an episode [policy steps]; 0: without end."""

  @property
  def control_dt(self) -> float:
    """Period of the policy [s]."""
    return self.physics_dt * self.decimation


@dataclass(frozen=True, kw_only=True)
class Origin:
  """Place of a reading in a MuJoCo model."""

  quantity: Literal[
    "joint_position", "joint_velocity", "sensor", "position", "orientation", "linear_velocity", "angular_velocity",
    "projected_gravity", "camera_rgb", "camera_depth",
  ]  # fmt: skip
  name: str = ""
  """Sensor, body, site or camera."""
  object_type: Literal["body", "site", "sensor", "camera", ""] = ""
  relative_to: str = ""
  """Body in whose frame a position or an orientation is; empty: the world."""
  geom_groups: tuple[int, ...] = ()
  """Geom groups that a camera shows; empty: all."""


@dataclass(frozen=True, kw_only=True)
class Input:
  """Input of the graph that a robot, an operator or a motion supplies."""

  name: str
  """Name in the graph: "imu/gyro", "joint/position", "command/velocity", "motion/joint_position" ..."""
  shape: tuple[int, ...]
  """Shape without the first axis, which has length 1."""
  unit: str = ""
  frame: str = ""
  """Frame of a vector: a body or site, or "world"."""
  columns: tuple[str, ...] = ()
  """Meaning of each column, such as joint names."""
  origin: Origin | None = None
  """Place in a MuJoCo model; None: MuJoCo alone cannot supply it."""


@dataclass(frozen=True, kw_only=True)
class Memory:
  """State of the graph: `output` of one step is `input` of the next; zeros at the start of an episode."""

  input: str
  output: str
  shape: tuple[int, ...]
  """Whole shape."""


@dataclass(frozen=True, kw_only=True)
class Target:
  """Output of the graph that goes to the motors."""

  name: str
  """Name in the graph."""
  quantity: Literal["position", "velocity", "effort"]
  joints: tuple[str, ...]
  """Joints in the order of the columns."""


@dataclass(frozen=True, kw_only=True)
class Observation:
  """Term of an observation; its value is part of the graph's output "observation/GROUP"."""

  group: str
  name: str
  columns: tuple[int, int]
  """First column in its group, and the one after its last; (0, 0) for an image, which is a separate group."""
  shape: tuple[int, ...]
  """Shape of one observation, history included."""
  sources: tuple[str, ...]
  """Inputs that it is computed from; "last_action" is a memory."""
  scale: float | Numbers | None = None
  clip: Range | None = None
  history_length: int = 0
  delay_range: tuple[int, int] = (0, 0)
  """Delays that the training drew [policy steps]; not part of the graph."""

  def part(self, group: Any) -> Any:
    """Return the columns of this term in the observation of its group, an array or a tensor without a first axis."""
    return group[slice(*self.columns)] if self.columns[1] else group


@dataclass(frozen=True, kw_only=True)
class Command:
  """Command that an operator gives."""

  input: str
  """Input of the graph."""
  name: str = ""
  """Name of the command in the task."""
  ranges: dict[str, Range]
  """Range that the training ended with by axis, in the order of the input's first columns."""


@dataclass(frozen=True, kw_only=True)
class Motion:
  """Clip that the policy follows, `motion.npz`; frame t + 1 is the target of step t."""

  rate: float
  """Frames per second."""
  num_frames: int
  joint_names: tuple[str, ...]
  name: str = ""
  """Name of the motion's command in the task."""
  anchor_body: str
  """Body at which the clip is aligned with the robot."""


@dataclass(frozen=True, kw_only=True)
class Golden:
  """Record of the training environment without noise, delays, pushes and randomisation, `golden.npz`."""

  steps: int
  engine: str = ""
  """Physics engine of the record."""


@dataclass(frozen=True, kw_only=True)
class Description:
  """Contents of `bundle.json`."""

  format: int = FORMAT
  task: str
  robot: Robot
  timing: Timing
  inputs: tuple[Input, ...]
  memories: tuple[Memory, ...]
  targets: tuple[Target, ...]
  observations: tuple[Observation, ...]
  action_names: tuple[str, ...]
  """Joint of each column of the raw action."""
  action_scale: Numbers | None = None
  """Shift of the target per unit of action; None if an action is not of the form scale * action + offset."""
  commands: tuple[Command, ...] = ()
  motion: Motion | None = None
  golden: Golden | None = None
  has_scene: bool = False
  """True if `scene.xml` is in the bundle."""
  files: dict[str, str] = field(default_factory=dict)
  """SHA-256 of each file."""
  created: str = ""
  """Local time, ISO 8601."""
  versions: dict[str, str] = field(default_factory=dict)
  training: dict[str, Any] = field(default_factory=dict)
  """Summary of the training: iterations, checkpoint and its hash, commit."""
  evaluation: dict[str, Any] = field(default_factory=dict)
  """Statistics of the last evaluation of this checkpoint."""
