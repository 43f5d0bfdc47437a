"""A motor learned from data: a network from the recent past of one joint to its effort.

After J. Hwangbo et al., "Learning agile and dynamic motor skills for legged robots", Science Robotics 4 (26), 2019.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import mujoco
import torch
from mjlab_core import HistoryBuffer, Limits, MjlabError, PositiveCount

from mjlab_actuators.actuator import Actuator, ActuatorCmd, ActuatorGroup, Column, CommandField
from mjlab_actuators.actuator_cfg import ActuatorCfg, EffortLimit, PerTarget
from mjlab_actuators.models.dc_motor import clip_to_dc_motor
from mjlab_actuators.models.network_file import Activation, load_network
from mjlab_actuators.transmission import Target

InputOrder = Literal["pos_vel", "vel_pos"]
"""Order of the columns: position errors before velocities, or after."""
Scale = Annotated[float, Limits(nonzero=True)]
"""Finite factor other than 0."""


class LearnedMlp(Actuator):
  """effort = clip(effort_scale network(x)), all worlds and joints as rows of one batch.

  x of one world and joint holds `history_length` position errors, newest first, times `position_scale`, and as many
  velocities, newest first, times `velocity_scale`, sampled in every substep; after a reset the first sample stands for
  those before it. The clip is `clip_to_dc_motor` where a motor is configured, else +-effort_limit.
  """

  history: HistoryBuffer
  """Scaled errors and velocities in the network's order, (num_envs, history_length, 2, n)."""
  effort_limit: torch.Tensor
  """Largest effort, (1, n) or (num_envs, n) [N or N m]; infinite without a limit."""
  saturation_effort: torch.Tensor
  """Stall effort, (1, n) or (num_envs, n) [N or N m]; only with a configured motor."""
  velocity_limit: torch.Tensor
  """No-load speed, (1, n) or (num_envs, n) [m/s or rad/s]; only with a configured motor."""

  network_file: str | Path
  activation: Activation
  history_length: int
  position_scale: float
  velocity_scale: float
  effort_scale: float
  input_order: InputOrder
  braking: bool

  def __init__(self, group: ActuatorGroup, columns: Sequence[Column], **memory: Any) -> None:
    super().__init__(group, columns, **memory)
    num_envs, device, num_inputs = self.num_envs, self.device, 2 * self.history_length
    self._shape = (num_envs, len(columns))
    self._clips = "saturation_effort" in group.parameter_names
    # Networks are stored in single precision, and so are their inputs.
    self.history = HistoryBuffer(self.history_length, num_envs, (2, self._shape[1]), device, torch.float32)
    scales = (self.position_scale, self.velocity_scale)
    self._position_first = self.input_order == "pos_vel"
    scales = scales if self._position_first else scales[::-1]
    self._scale = torch.tensor(scales, device=device, dtype=self.dtype)[:, None]
    self.network = load_network(self.network_file, num_inputs=num_inputs, activation=self.activation, device=device)
    # TorchScript compiles during its first calls, which must not happen while a step is recorded.
    rows = torch.zeros(num_envs * self._shape[1], num_inputs, device=device)
    for _ in range(3):
      self.network(rows)

  def compute(self, cmd: ActuatorCmd) -> torch.Tensor:
    """Return the clipped output of the network."""
    (target,) = self._delayed_targets(cmd)
    error, velocity = target - cmd.position, cmd.velocity
    pair = (error, velocity) if self._position_first else (velocity, error)
    self.history.append(torch.stack(pair, dim=1).mul_(self._scale))
    # (worlds, time, 2, joints), oldest first -> rows of (world, joint), columns of (2, time), newest first.
    rows = self.history.read().flip(1).permute(0, 3, 2, 1).reshape(-1, 2 * self.history.length)
    effort = self.network(rows).view(self._shape).to(self.dtype) * self.effort_scale
    if not self._clips:
      return torch.clamp(effort, -self.effort_limit, self.effort_limit, out=effort)
    return clip_to_dc_motor(
      effort,
      cmd.velocity,
      saturation_effort=self.saturation_effort,
      velocity_limit=self.velocity_limit,
      effort_limit=self.effort_limit,
      braking=self.braking,
    )

  def reset(self, mask: torch.Tensor, cmd: ActuatorCmd) -> None:
    """Forget earlier targets and samples."""
    super().reset(mask, cmd)
    self.history.reset(mask)


@dataclass(kw_only=True)
class LearnedMlpActuatorCfg(ActuatorCfg):
  """A network that gives the effort of each joint from the recent past of its position error and velocity.

  Its history is sampled in every physics substep: the network must have been trained at that period, which is checked
  if `sample_period` is given. Velocity and effort targets are not read.
  """

  network_file: str | Path
  """TorchScript archive, or plain state dict of linear layers; (m, 2 history_length) -> (m, 1)."""
  activation: Activation = "softsign"
  """Function between the layers of a state dict; a TorchScript archive has its own."""
  history_length: PositiveCount = 3
  """Samples of each, the present one included [substeps]."""
  sample_period: float | None = None
  """Period of the samples that the network was trained on [s]; a model of another timestep is refused."""
  position_scale: Scale = 1.0
  """Factor of position errors before the network."""
  velocity_scale: Scale = 1.0
  """Factor of velocities before the network."""
  effort_scale: Scale = 1.0
  """Factor of the network's output [N or N m]."""
  input_order: InputOrder = "pos_vel"
  """Order of position errors and velocities."""
  effort_limit: EffortLimit = None
  """Largest effort [N or N m]; None for no limit."""
  saturation_effort: Annotated[PerTarget | None, Limits(gt=0)] = None
  """Stall effort of the torque-speed line [N or N m]; None for no such line. See `clip_to_dc_motor`."""
  velocity_limit: Annotated[PerTarget | None, Limits(gt=0)] = None
  """No-load speed of the torque-speed line [m/s or rad/s]; given with `saturation_effort` or not at all."""
  braking: bool = False
  """True if the motor is forced to brake where it turns faster than its no-load speed."""

  command_fields: ClassVar[tuple[CommandField, ...]] = ("position_target",)

  actuator_model = LearnedMlp
  setting_fields = (
    "network_file",
    "activation",
    "history_length",
    "position_scale",
    "velocity_scale",
    "effort_scale",
    "input_order",
    "braking",
  )

  def problems(self, target_names: Sequence[str]) -> Iterator[str]:
    """Yield problems of fields that keep their own constraints, and of the network."""
    yield from super().problems(target_names)
    for given, other in (("saturation_effort", "velocity_limit"), ("velocity_limit", "saturation_effort")):
      if getattr(self, other) is None:
        yield from self._given((given,), f"{other} is not; the torque-speed line needs both")
    try:
      load_network(self.network_file, num_inputs=2 * self.history_length, activation=self.activation)
    except ValueError as error:
      yield str(error)

  def groups(
    self, model: mujoco.MjModel, elements: Mapping[Target, Sequence[int]]
  ) -> dict[ActuatorGroup, list[Column]]:
    """Return the columns of this config, if the network was trained at the timestep of the model."""
    timestep = model.opt.timestep
    if self.sample_period is not None and not math.isclose(self.sample_period, timestep, rel_tol=1e-6):
      raise MjlabError(
        f"{type(self).__name__}: the network was trained on samples every {self.sample_period} s, "
        f"the model has a timestep of {timestep} s"
      )
    return super().groups(model, elements)

  def parameters(self, target_names: Sequence[str]) -> list[dict[str, float]]:
    """Return the limit, and the torque-speed line if one is configured, for each target."""
    line = () if self.saturation_effort is None else ("saturation_effort", "velocity_limit")
    return self._numbers(target_names, "effort_limit", *line)
