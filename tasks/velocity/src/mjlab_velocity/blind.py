"""Velocity tasks whose actor sees only what sensors of the robot measure."""

from mjlab_core.errors import ConfigError
from mjlab_envs import ManagerBasedRlEnvCfg
from mjlab_rl import RslRlOnPolicyRunnerCfg, TaskCfg

UNMEASURED = ("base_lin_vel", "height_scan")
"""Terms of the actor that encoders and an IMU do not give."""
HISTORY = 5
"""Frames that the actor sees, from which a network can estimate the velocity; the newest is the last of each term."""


def blind(task: TaskCfg[ManagerBasedRlEnvCfg]) -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Return a velocity task whose actor sees `HISTORY` frames of encoders, IMU, command and its own actions.

  The critic still sees everything. The task is changed in place.

  Raises:
    ConfigError: The task has no observation group "actor" or another kind of learner.
  """
  actor = task.env.observations.get("actor")
  if actor is None or not isinstance(task.agent, RslRlOnPolicyRunnerCfg):
    raise ConfigError("a blind task needs an observation group 'actor' and an RslRlOnPolicyRunnerCfg")
  actor.terms = {name: term for name, term in actor.terms.items() if name not in UNMEASURED}
  actor.history_length = HISTORY
  task.agent.experiment_name += "_blind"
  return task
