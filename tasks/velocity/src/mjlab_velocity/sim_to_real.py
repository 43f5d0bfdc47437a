"""Velocity tasks for real robots: actors with measurable observations, and a preset of randomisation and delays."""

from collections.abc import Callable, Iterable

from mjlab_actuators import DcMotorActuatorCfg, NativePositionActuatorCfg
from mjlab_core import check_name, require
from mjlab_dr import pseudo_inertia, randomize_field
from mjlab_envs import ManagerBasedRlEnvCfg, mdp
from mjlab_managers import EventTermCfg, ObservationGroupCfg
from mjlab_rl import RslRlOnPolicyRunnerCfg, TaskCfg

from mjlab_velocity.levels import actuators_of, add_axis, torso_pattern

UNMEASURED = ("base_lin_vel", "height_scan")
"""Terms of the actor that encoders and an IMU do not give."""
HISTORY = 5
"""Frames that the actor sees, from which a network can estimate the velocity; the newest is the last of each term."""
# Ranges of the preset
TORSO_ALPHA = (-0.05, 0.2)  # mass and inertia times e^(2 alpha): 0.90 to 1.49
LINK_SCALE = 0.05
COM_SHIFT = (-0.03, 0.03)  # m
GAINS = (0.9, 1.1)
ACTUATOR_DELAY = 4  # physics steps, at most: 20 ms
SENSOR_DELAY = 1  # policy steps, at most: 20 ms
PUSH_FACTOR = 2.0

MEASURED = ("base_ang_vel", "projected_gravity", "joint_pos", "joint_vel")
"""Observations of the actor that arrive late."""


def sim_to_real(
  task: TaskCfg[ManagerBasedRlEnvCfg], parts: Iterable[str] | None = None
) -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Change a velocity task in place, so that it trains for a real robot and not for one model of it.

  | part | change |
  |---|---|
  | `inertia` | mass, centre of mass and inertia of all bodies are drawn; replaces the event `base_com` |
  | `gains` | gains of each joint are scaled by 0.9 to 1.1 |
  | `actuator_delay` | targets arrive up to 20 ms late, constant in a world |
  | `sensor_delay` | encoders and IMU up to one step of the policy late, constant in a world |
  | `torque_speed` | native servos become DC motors; their torque falls to 0 at the top speed |
  | `pushes` | twice as large |

  Friction of the feet and errors of encoders are drawn by the task already.

  Args:
    task: Velocity task, as in `go1_flat()`.
    parts: Names of the table; None: all of them.

  Raises:
    UnknownNameError: There is no such part.
    ConfigError: The task has no event that a part changes; the message names it.
  """
  for name in PARTS if parts is None else parts:
    check_name("part of sim_to_real", name, PARTS)
    PARTS[name](task.env)
  return _named(task, "_sim_to_real")


def _vary_inertia(cfg: ManagerBasedRlEnvCfg) -> None:
  _event(cfg, "base_com")
  torso = torso_pattern(cfg)
  cfg.events["base_com"] = None
  cfg.events["torso_inertia"] = mdp.randomize_at_startup(pseudo_inertia(torso, alpha=TORSO_ALPHA, t=COM_SHIFT))
  cfg.events["link_inertia"] = mdp.randomize_at_startup(pseudo_inertia(f"(?!({torso})$).*", scale=LINK_SCALE))


def _vary_gains(cfg: ManagerBasedRlEnvCfg) -> None:
  for name in ("stiffness", "damping"):
    cfg.events[name] = mdp.randomize_at_startup(randomize_field(name, ".*", GAINS, operation="scale"))


def _delay_targets(cfg: ManagerBasedRlEnvCfg) -> None:
  add_axis(cfg, "actuator_delay", tuple(range(ACTUATOR_DELAY + 1)))


def _delay_sensors(cfg: ManagerBasedRlEnvCfg) -> None:
  actor = cfg.observations["actor"]
  for name in MEASURED:
    term = None if actor is None else actor.terms.get(name)
    if term is not None:
      term.delay_max_lag = SENSOR_DELAY


def _push_harder(cfg: ManagerBasedRlEnvCfg) -> None:
  params = _event(cfg, "push_robot").params
  params["velocity_range"] = {
    axis: (PUSH_FACTOR * low, PUSH_FACTOR * high) for axis, (low, high) in params["velocity_range"].items()
  }


def _event(cfg: ManagerBasedRlEnvCfg, name: str) -> EventTermCfg:
  return require(cfg.events.get(name), EventTermCfg, f"sim_to_real: the task has no event '{name}'")


def _limit_torque_by_speed(cfg: ManagerBasedRlEnvCfg) -> None:
  articulation = cfg.scene.entities["robot"].articulation
  assert articulation is not None
  motors = []
  for servo in actuators_of(cfg):
    if isinstance(servo, NativePositionActuatorCfg) and servo.velocity_limit and servo.effort_limit:
      motors.append(
        DcMotorActuatorCfg(
          target_names_expr=servo.target_names_expr,
          stiffness=servo.stiffness,
          damping=servo.damping,
          armature=servo.armature,
          effort_limit=servo.effort_limit,
          saturation_effort=servo.effort_limit,
          velocity_limit=servo.velocity_limit,
        )
      )
    else:
      motors.append(servo)
  articulation.actuators = tuple(motors)


PARTS: dict[str, Callable[[ManagerBasedRlEnvCfg], None]] = {
  "torque_speed": _limit_torque_by_speed,
  "inertia": _vary_inertia,
  "gains": _vary_gains,
  "actuator_delay": _delay_targets,
  "sensor_delay": _delay_sensors,
  "pushes": _push_harder,
}
"""Parts of `sim_to_real` by name, in the order in which they change a task."""


def blind(task: TaskCfg[ManagerBasedRlEnvCfg]) -> TaskCfg[ManagerBasedRlEnvCfg]:
  """Change a velocity task in place: its actor sees `HISTORY` frames of encoders, IMU, command and its own actions.

  The critic still sees everything.

  Raises:
    ConfigError: The task has no observation group "actor" or another kind of learner.
  """
  needs = "a blind task needs an observation group 'actor' and an RslRlOnPolicyRunnerCfg"
  actor = require(task.env.observations.get("actor"), ObservationGroupCfg, needs)
  require(task.agent, RslRlOnPolicyRunnerCfg, needs)
  actor.terms = {name: term for name, term in actor.terms.items() if name not in UNMEASURED}
  actor.history_length = HISTORY
  return _named(task, "_blind")


def _named(task: TaskCfg[ManagerBasedRlEnvCfg], suffix: str) -> TaskCfg[ManagerBasedRlEnvCfg]:
  for agent in (task.agent, *task.agents.values()):
    agent.experiment_name += suffix
  return task
