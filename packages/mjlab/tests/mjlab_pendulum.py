"""Smallest task that trains: a torque keeps a pole on a hinge upright."""

import warnings
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

import mjlab
import mujoco
import pytest
from mjlab import registry
from mjlab_actuators import NativeMotorActuatorCfg
from mjlab_envs import ManagerBasedRlEnvCfg, mdp
from mjlab_managers import (
  EventTermCfg,
  ObservationGroupCfg,
  ObservationTermCfg,
  RewardTermCfg,
  SceneEntityCfg,
  TerminationTermCfg,
  UniformNoiseCfg,
)
from mjlab_rl import (
  RslRlDistillationRunnerCfg,
  RslRlModelCfg,
  RslRlOnPolicyRunnerCfg,
  TaskCfg,
)
from mjlab_scene import EntityArticulationCfg, EntityCfg, SceneCfg
from mjlab_sim import SimulationCfg

TASK = "Test-Pendulum"

_XML = """
<mujoco>
  <worldbody>
    <body name="pole">
      <joint name="hinge" type="hinge" axis="0 1 0" damping="0.01"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.5" size="0.02" mass="0.2"/>
    </body>
  </worldbody>
</mujoco>
"""


def spec() -> mujoco.MjSpec:
  return mujoco.MjSpec.from_string(_XML)


def for_watching(cfg: ManagerBasedRlEnvCfg) -> ManagerBasedRlEnvCfg:
  cfg.episode_length_s = 1e6
  return cfg


def pendulum() -> TaskCfg[ManagerBasedRlEnvCfg]:
  robot = EntityCfg(
    spec_fn=spec,
    articulation=EntityArticulationCfg(
      actuators=(NativeMotorActuatorCfg(target_names_expr=("hinge",), effort_limit=1.0),)
    ),
  )
  terms: dict[str, ObservationTermCfg | None] = {
    "position": ObservationTermCfg(mdp.joint_pos_rel, noise=UniformNoiseCfg(n_min=-0.01, n_max=0.01)),
    "velocity": ObservationTermCfg(mdp.joint_vel_rel),
  }
  env = ManagerBasedRlEnvCfg(
    decimation=2,
    episode_length_s=0.5,
    scene=SceneCfg(num_envs=8, entities={"robot": robot}),
    sim=SimulationCfg(timestep=0.01),
    observations={"actor": ObservationGroupCfg(terms=terms), "critic": ObservationGroupCfg(terms=terms)},
    actions={"torque": mdp.JointEffortActionCfg(actuators=("hinge",))},
    rewards={
      "alive": RewardTermCfg(mdp.is_alive, weight=1.0),
      "joint_speed": RewardTermCfg(mdp.joint_vel_l2, weight=-0.01, params={"asset": SceneEntityCfg("robot")}),
    },
    terminations={"time_out": TerminationTermCfg(mdp.time_out, time_out=True)},
    events={
      "reset": EventTermCfg(mdp.reset_scene_to_default, mode="reset"),
      "shake": EventTermCfg(
        mdp.reset_joints_by_offset,
        mode="reset",
        params={"position_range": (-0.1, 0.1), "velocity_range": (0.0, 0.0)},
      ),
    },
  )
  agent = RslRlOnPolicyRunnerCfg(
    experiment_name="pendulum", max_iterations=3, num_steps_per_env=8, save_interval=100, logger="none"
  )
  agent.actor.hidden_dims = (8,)
  agent.algorithm.num_learning_epochs = agent.algorithm.num_mini_batches = 1
  agent.critic = RslRlModelCfg(hidden_dims=(8,))
  return TaskCfg(env=env, play=for_watching, agent=agent)


def taught() -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return the task of imitating a policy of the pendulum."""
  task = pendulum()
  task.env.observations["teacher"] = task.env.observations.pop("critic")
  agent = RslRlDistillationRunnerCfg(
    experiment_name="taught", max_iterations=2, num_steps_per_env=8, save_interval=100, logger="none"
  )
  agent.student.hidden_dims = (8,)
  return TaskCfg(env=task.env, play=for_watching, agent=agent)


def write_onnx(checkpoint: Path, path: Path) -> None:
  """Export a policy by the runner, without its warnings."""
  # Programs that only watch import no learner.
  from mjlab.environments import standard_env
  from mjlab_rl import CheckpointPolicy, load_run

  run = load_run(checkpoint)
  with standard_env(run.env, device="cpu") as env, warnings.catch_warnings():
    policy = CheckpointPolicy(env, run.agent, run.runner)
    policy.load(checkpoint)
    warnings.simplefilter("ignore")
    policy._runner.export_policy_to_onnx(str(path.parent), path.name)


@contextmanager
def registered() -> Generator[None]:
  """Register this task only, beside those of packages."""
  with pytest.MonkeyPatch.context() as patched:
    patched.setattr(registry, "_registered", {})
    mjlab.register_task(TASK, pendulum)
    yield
