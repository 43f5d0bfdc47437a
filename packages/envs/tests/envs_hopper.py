"""A robot of three bodies and the smallest task that uses every part of an environment."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import torch
from mjlab_actuators import NativePositionActuatorCfg
from mjlab_core.indexing import where_
from mjlab_core.rotations import quat_apply_inverse
from mjlab_core.sampling import uniform
from mjlab_envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg, mdp
from mjlab_managers import (
  CommandTerm,
  CommandTermCfg,
  EventTermCfg,
  ManagerTermBase,
  MetricsTermCfg,
  ObservationGroupCfg,
  ObservationTermCfg,
  RewardTermCfg,
  SceneEntityCfg,
  TerminationTermCfg,
  UniformNoiseCfg,
)
from mjlab_scene import EntityArticulationCfg, EntityCfg, InitialStateCfg, SceneCfg
from mjlab_sim import SimulationCfg
from mjlab_terrain import PlaneCfg

# Makes an environment, of which tests also touch what is not public.
Make = Callable[..., Any]

HOPPER = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="trunk" pos="0 0 .7">
      <freejoint/>
      <geom name="trunk" type="box" size=".15 .1 .05" mass="3"/>
      <site name="imu"/>
      <body name="thigh" pos="0 0 -.05">
        <joint name="hip" axis="0 1 0" range="-1 1" armature=".01"/>
        <geom name="thigh" type="capsule" size=".03" fromto="0 0 0 0 0 -.25" mass=".5" contype="0" conaffinity="0"/>
        <body name="shank" pos="0 0 -.25">
          <joint name="knee" axis="0 1 0" range="-1.5 .5" armature=".01"/>
          <geom name="shank" type="capsule" size=".025" fromto="0 0 0 0 0 -.25" mass=".2" contype="0" conaffinity="0"/>
          <geom name="foot" size=".04" pos="0 0 -.25" mass=".1"/>
        </body>
      </body>
    </body>
  </worldbody>
  <sensor><gyro name="gyro" site="imu"/><accelerometer name="accelerometer" site="imu"/></sensor>
</mujoco>
"""


def hopper() -> EntityCfg:
  servo = NativePositionActuatorCfg(target_names_expr=(".*",), stiffness=30.0, damping=1.0, effort_limit=40.0)
  return EntityCfg(
    spec_fn=lambda: mujoco.MjSpec.from_string(HOPPER),
    init_state=InitialStateCfg(pos=(0.0, 0.0, 0.62), joint_pos={"hip": 0.2, "knee": -0.4}),
    articulation=EntityArticulationCfg(actuators=(servo,), soft_joint_pos_limit_factor=0.9),
  )


@dataclass(kw_only=True)
class SpeedCommandCfg(CommandTermCfg):
  """A speed, uniform in [-1, 1]."""

  def build(self, env: Any) -> "SpeedCommand":
    return SpeedCommand(self, env)


class SpeedCommand(CommandTerm):
  """See `SpeedCommandCfg`."""

  def __init__(self, cfg: SpeedCommandCfg, env: ManagerBasedRlEnv) -> None:
    super().__init__(cfg, env)
    self._command = self.state((1,))
    self.metrics["error"] = torch.zeros(env.num_envs, device=env.device)

  @property
  def command(self) -> torch.Tensor:
    return self._command

  def resample(self, mask: torch.Tensor) -> None:
    draw = uniform(-1.0, 1.0, self._command.shape, generator=self.env.rng, device=self.device, dtype=torch.float32)
    where_(self._command, mask, draw)

  def update_metrics(self) -> None:
    # Of state alone: commands come between the resets and the pushes of a step, where kinematics would be computed for
    # them alone. Worlds just reset have not moved under their new command.
    data = self.env.scene["robot"].data
    speed = quat_apply_inverse(data.root_link_quat_w, data.root_link_lin_vel_w)[:, 0]
    self.metrics["error"] += (speed - self._command[:, 0]).abs() * ~self.env.command_manager.fresh


class Ended(ManagerTermBase):
  """Ends the episodes of the worlds in `worlds`, bool (num_envs,), which a test writes."""

  def __init__(self, env: ManagerBasedRlEnv) -> None:
    super().__init__(env)
    self.worlds = self.state(dtype=torch.bool)

  def __call__(self) -> torch.Tensor:
    return self.worlds.clone()

  def reset(self, mask: torch.Tensor) -> None:
    """Leave it to the test."""


def end(env: Any, *worlds: int) -> None:
  """In the next steps the episodes of these worlds end."""
  mask = env.termination_manager.get_term_cfg("ended").func.worlds
  mask.zero_()
  for world in worlds:
    mask[world] = True


def track_speed(env: ManagerBasedRlEnv, *, command: str) -> torch.Tensor:
  """exp(-(v_x - command)^2), (num_envs,)."""
  speed = env.scene["robot"].data.root_link_lin_vel_b[:, 0]
  return torch.exp(-(speed - env.command_manager.get_command(command)[:, 0]).square())


def height(env: ManagerBasedRlEnv) -> torch.Tensor:
  """Height of the root, (num_envs, 1) [m]."""
  return env.scene["robot"].data.root_link_pos_w[:, 2:]


def accelerometer(env: ManagerBasedRlEnv) -> torch.Tensor:
  """What the IMU feels, (num_envs, 3) [m/s^2]."""
  return env.scene["robot/accelerometer"].data


def hopper_cfg(num_envs: int = 4, engine: str = "native", **options: Any) -> Any:
  """Observations with noise, delay and history; pushes, commands, resets and randomisation."""
  joints = SceneEntityCfg("robot", joint_names=(".*",))
  noise = UniformNoiseCfg(n_min=-0.05, n_max=0.05)
  sim: dict[str, Any] = {"engine": engine, "timestep": 0.005, "num_threads": 1, "iterations": 10, "ls_iterations": 20}
  cfg = ManagerBasedRlEnvCfg(
    decimation=2,
    episode_length_s=0.2,
    seed=7,
    scene=SceneCfg(num_envs=num_envs, terrain=PlaneCfg(), entities={"robot": hopper()}),
    sim=SimulationCfg(nconmax=8, njmax=32, **sim),
    actions={"legs": mdp.JointPositionActionCfg(scale=0.5)},
    commands={"speed": SpeedCommandCfg(resampling_time_range=(0.05, 0.1))},
    observations={
      "actor": ObservationGroupCfg(
        corrupt=True,
        terms={
          "height": ObservationTermCfg(height),
          "gyro": ObservationTermCfg(mdp.builtin_sensor, params={"sensor": "robot/gyro"}, noise=noise),
          "gravity": ObservationTermCfg(mdp.projected_gravity, noise=noise),
          "joint_pos": ObservationTermCfg(
            mdp.joint_pos_rel, params={"asset": joints, "biased": True}, history_length=2
          ),
          "joint_vel": ObservationTermCfg(mdp.joint_vel_rel, delay_min_lag=0, delay_max_lag=2),
          "action": ObservationTermCfg(mdp.last_action),
          "command": ObservationTermCfg(mdp.generated_commands, params={"command": "speed"}),
        },
      ),
      "critic": ObservationGroupCfg(
        terms={
          "velocity": ObservationTermCfg(mdp.base_lin_vel),
          "spin": ObservationTermCfg(mdp.base_ang_vel),
          "accelerometer": ObservationTermCfg(accelerometer),
        }
      ),
    },
    rewards={
      "speed": RewardTermCfg(track_speed, weight=1.0, params={"command": "speed"}),
      "alive": RewardTermCfg(mdp.is_alive, weight=0.5),
      "action_rate": RewardTermCfg(mdp.action_rate_l2, weight=-0.01),
      "torques": RewardTermCfg(mdp.joint_torques_l2, weight=-1e-4),
    },
    terminations={
      "time_out": TerminationTermCfg(mdp.time_out, time_out=True),
      "ended": TerminationTermCfg(Ended),
      "fell": TerminationTermCfg(mdp.bad_orientation, params={"limit_angle": 1.0}),
    },
    events={
      "root": EventTermCfg(
        mdp.reset_root_state_uniform,
        mode="reset",
        params={
          "pose_range": {"x": (-0.1, 0.1), "yaw": (-3.0, 3.0)},
          "velocity_range": {"x": (-0.3, 0.3), "z": (-0.1, 0.1)},
        },
      ),
      "joints": EventTermCfg(
        mdp.reset_joints_by_offset,
        mode="reset",
        params={"position_range": (-0.2, 0.2), "velocity_range": (-0.5, 0.5)},
      ),
      "push": EventTermCfg(
        mdp.push_by_setting_velocity,
        mode="interval",
        interval_range_s=(0.02, 0.05),
        params={"velocity_range": {"x": (-0.5, 0.5), "yaw": (-0.5, 0.5)}},
      ),
    },
    metrics={"jerk": MetricsTermCfg(mdp.mean_action_acc)},
  )
  for name, value in options.items():
    setattr(cfg, name, value)
  return cfg


def actions(env: ManagerBasedRlEnv, seed: int) -> torch.Tensor:
  """Actions of one step, the same for all environments of a size."""
  generator = torch.Generator().manual_seed(seed)
  shape = (env.num_envs, env.action_manager.total_action_dim)
  return torch.randn(shape, generator=generator).to(env.device)
