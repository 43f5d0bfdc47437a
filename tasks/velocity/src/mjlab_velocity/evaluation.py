"""Evaluation of a velocity policy: a grid of commands, with pushes of several sizes."""

import math
from dataclasses import dataclass, field
from itertools import combinations
from typing import TYPE_CHECKING, Annotated

import torch
from mjlab_core import Items, PositiveCount, check_fields, require
from mjlab_envs import ManagerBasedRlEnvCfg, mdp
from mjlab_managers import EventTermCfg, ManagerTermBase, MetricsTermCfg
from mjlab_rl import Evaluation, Policy, Progress, play_first_episodes, summarize

from mjlab_velocity.levels import in_turn, set_level
from mjlab_velocity.mdp import UniformVelocityCommandCfg
from mjlab_velocity.mdp.rewards import landed, landing_force, linear_error_squared, turning_error_squared

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

Command = tuple[float, float, float]
"""Forward and sideways [m/s] and turning speed [rad/s]."""

GRID: tuple[Command, ...] = (
  (0.0, 0.0, 0.0),
  (0.5, 0.0, 0.0),
  (1.0, 0.0, 0.0),
  (-0.5, 0.0, 0.0),
  (0.0, 0.5, 0.0),
  (0.0, -0.5, 0.0),
  (0.0, 0.0, 0.5),
  (0.0, 0.0, -0.5),
  (0.5, 0.0, 0.5),
)
GRAVITY = 9.81
WALKING = 0.3
"""Least commanded speed at which the cost of transport is measured [m/s]."""


def hold_commands(env: "ManagerBasedRlEnv", mask: torch.Tensor, *, command: str, grid: tuple[Command, ...]) -> None:
  """Fix the velocity command of each world, from a list in turn."""
  term = env.command_manager.get_term(command)
  for world in mask.nonzero().flatten().tolist():
    term.steer(world, grid[world % len(grid)])


class push_by_level(ManagerTermBase):
  """Add a horizontal velocity in a random direction to the root; its size is constant in a world.

  World i has level (i // block) mod len(levels) of `levels` [m/s].
  """

  env: "ManagerBasedRlEnv"

  def __init__(self, env: "ManagerBasedRlEnv", *, levels: tuple[float, ...], block: int) -> None:
    super().__init__(env)
    self._size = in_turn(torch.tensor(levels, device=env.device, dtype=env.sim.dtype), env.num_envs, block)

  def __call__(self, mask: torch.Tensor) -> None:
    env = self.env
    angle = 2.0 * torch.pi * torch.rand(env.num_envs, generator=env.rng, device=env.device, dtype=env.sim.dtype)
    push = torch.stack((angle.cos(), angle.sin()), 1) * self._size[:, None]
    robot = env.scene["robot"]
    velocity = torch.cat((robot.data.root_link_lin_vel_w, robot.data.root_link_ang_vel_w), -1)
    robot.write_root_velocity(velocity + torch.nn.functional.pad(push, (0, 4)), mask)


@dataclass(kw_only=True)
class VelocityEvaluation:
  """Falls, errors and effort over a grid of commands and pushes.

  Every command is played with every push and all `levels`, with the noise, randomisation and terrain of training.
  Metrics:

  - `fall_rate`: share of episodes that ended in failure;
  - `lin_vel_rmse`, `yaw_rate_rmse`: root mean square errors of the root's velocity in its own frame, while alive;
  - `cost_of_transport`: mean of |torque x joint velocity| over mass, gravity and mean speed, for commands to walk;
  - `torque_rms`, `action_change`: root mean squares over time and joints of torques, and of the changes of actions;
  - `foot_impact`: mean contact force of a foot in the step in which it lands, over the robot's weight.
  """

  grid: Annotated[tuple[Command, ...], Items()] = GRID
  pushes: Annotated[tuple[float, ...], Items()] = (0.0, 0.5, 1.0)
  """Sizes of pushes [m/s], one kind for each episode."""
  push_interval: float = 3.0
  """Time between pushes [s]."""
  levels: dict[str, Annotated[tuple[float, ...], Items()]] = field(default_factory=dict)
  """Values of randomised quantities by event; worlds take them in turn instead of draws.

  Any event that draws by a `randomizer` can be named, and "actuator_delay" [physics steps] and "payload" [kg]. Every
  combination of levels, pushes and commands is played, and every pair of levels is a group of the results."""
  repeats: PositiveCount = 8
  """Episodes of each combination."""
  seconds: float = 10.0
  """Length of an episode [s]."""
  seed: int = 0
  """Seed of randomisation, starts, noise and directions of pushes."""
  command: str = "twist"
  """Name of the velocity command."""
  feet: str = "feet_ground_contact"
  """Contact sensor of the feet; without it there is no `foot_impact`."""

  def configure(self, cfg: ManagerBasedRlEnvCfg) -> ManagerBasedRlEnvCfg:
    check_fields(self, "eval")
    wrong = f"command '{self.command}' is not a velocity command; commands: {', '.join(cfg.commands)}"
    term = require(cfg.commands.get(self.command), UniformVelocityCommandCfg, wrong)
    term.resampling_time_range, term.initial_velocity_fraction = None, 0.0
    held = {"command": self.command, "grid": self.grid}
    cfg.events["hold_commands"] = EventTermCfg(hold_commands, mode="startup", params=held)
    cfg.scene.num_envs = math.prod(map(len, self._axes())) * self.repeats
    block = len(self.grid) * len(self.pushes)
    for name, values in self.levels.items():
      set_level(cfg, name, tuple(values), block)
      block *= len(values)
    cfg.seed, cfg.episode_length_s = self.seed, self.seconds
    # Curricula would change the task during the measurement.
    cfg.curriculum = {}
    cfg.events["push_robot"] = EventTermCfg(
      push_by_level,
      mode="interval",
      interval_range_s=(self.push_interval, self.push_interval),
      params={"levels": self.pushes, "block": len(self.grid)},
    )
    cfg.metrics = {
      "lin_vel_error2": MetricsTermCfg(linear_error_squared, params={"command": self.command}),
      "yaw_rate_error2": MetricsTermCfg(turning_error_squared, params={"command": self.command}),
      "power": MetricsTermCfg(mechanical_power),
      "speed": MetricsTermCfg(horizontal_speed),
      "torque2": MetricsTermCfg(torque_squared),
      "action_change2": MetricsTermCfg(mdp.action_rate_l2),
    }
    if cfg.scene.sensors.get(self.feet) is not None:
      cfg.metrics["landings"] = MetricsTermCfg(landings, params={"sensor": self.feet})
      cfg.metrics["landing_force"] = MetricsTermCfg(landing_force, params={"sensor": self.feet})
    return cfg

  def _axes(self) -> list[list[str]]:
    """Return the labels of commands, pushes and levels; the first change fastest from world to world."""
    pushes = [f"push {size:g} m/s" for size in self.pushes]
    levels = [[f"{name} {value:g}" for value in values] for name, values in self.levels.items()]
    return [[_said(value) for value in self.grid], pushes, *levels]

  def _groups(self, num_envs: int) -> dict[str, torch.Tensor]:
    axes: list[dict[str, torch.Tensor]] = []
    block = 1
    for labels in self._axes():
      place = in_turn(torch.arange(len(labels)), num_envs, block)
      axes.append({label: place == i for i, label in enumerate(labels)})
      block *= len(labels)
    groups = {label: mask for axis in axes for label, mask in axis.items()}
    # Pairs of conditions; those with commands alone are many, and the same for each.
    for one, other in combinations(axes[1:], 2):
      groups |= {f"{a}, {b}": one[a] & other[b] for a in one for b in other}
    return groups

  def run(self, env: "ManagerBasedRlEnv", policy: Policy, progress: Progress | None = None) -> Evaluation:
    names = tuple(env.cfg.metrics)
    played = play_first_episodes(
      env,
      policy,
      lambda: {name: env.metrics_manager.get_value(name) for name in names},
      max_steps=env.max_episode_length,
      seed=self.seed,
      progress=progress,
    )
    groups = self._groups(env.num_envs)
    wanted = in_turn(torch.tensor(self.grid, dtype=torch.float64)[:, :2].norm(dim=-1), env.num_envs)
    # Masses may be randomised.
    weight = env.sim.model.body_subtreemass[:, env.scene["robot"].indexing.root_body].double().cpu() * GRAVITY
    cost = played.mean("power") / (weight * played.mean("speed"))
    metrics = {
      "fall_rate": played.has_failed.double(),
      "lin_vel_rmse": played.mean("lin_vel_error2").sqrt(),
      "yaw_rate_rmse": played.mean("yaw_rate_error2").sqrt(),
      "cost_of_transport": torch.where(wanted >= WALKING, cost, torch.nan),
      "torque_rms": played.mean("torque2").sqrt(),
      "action_change": (played.mean("action_change2") / env.action_manager.total_action_dim).sqrt(),
      "survived": played.length * env.step_dt,
    }
    if "landings" in names:
      # No landing: NaN, which no mean counts.
      metrics["foot_impact"] = played.mean("landing_force") / (weight * played.mean("landings"))
    curves = {
      "alive": (~played.values["speed"].isnan()).double(),
      "lin_vel_error": played.values["lin_vel_error2"].sqrt(),
      "yaw_rate_error": played.values["yaw_rate_error2"].sqrt(),
    }
    units = {
      "lin_vel_rmse": "m/s",
      "yaw_rate_rmse": "rad/s",
      "torque_rms": "N m",
      "survived": "s",
      "lin_vel_error": "m/s",
      "yaw_rate_error": "rad/s",
    }
    return summarize(metrics, groups, units=units, values=curves, steps_per_second=round(1.0 / env.step_dt))


def _said(command: Command) -> str:
  parts = [f"{name} {value:+g}" for name, value in zip(("vx", "vy", "wz"), command, strict=True) if value]
  return " ".join(parts) or "stand"


def mechanical_power(env: "ManagerBasedRlEnv") -> torch.Tensor:
  """Return the sum over joints of |torque x velocity|, (num_envs,) [W]."""
  data = env.scene["robot"].data
  return (data.qfrc_actuator * data.joint_vel).abs().sum(-1)


def horizontal_speed(env: "ManagerBasedRlEnv") -> torch.Tensor:
  """Return the horizontal speed of the root, (num_envs,) [m/s]."""
  return torch.linalg.vector_norm(env.scene["robot"].data.root_link_lin_vel_w[:, :2], dim=-1)


def torque_squared(env: "ManagerBasedRlEnv") -> torch.Tensor:
  """Return the mean over joints of the squared torque, (num_envs,) [N^2 m^2]."""
  return env.scene["robot"].data.qfrc_actuator.square().mean(-1)


def landings(env: "ManagerBasedRlEnv", *, sensor: str) -> torch.Tensor:
  """Return the number of feet that just landed, (num_envs,)."""
  return landed(env, sensor).sum(-1, dtype=torch.float32)
