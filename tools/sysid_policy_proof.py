r"""Policies of a wrong and of an identified model on the "real" robot: falls and tracking errors.

The real Go1 is MuJoCo C at 1 ms a step with the numbers in `REAL`, of which the model of the repository knows nothing.
All that is learned about it comes from one record on a stand.

  uv run python tools/sysid_policy_proof.py record go1.npz
  uv run sysid go1.npz --task Mjlab-Velocity-Flat-Unitree-Go1 --output docs/benchmarks/sysid_go1.json --fit \
    $(uv run python tools/sysid_policy_proof.py terms)
  uv run train Mjlab-Velocity-Flat-Unitree-Go1 --seed 1 --agent.run-name wrong --agent.max-iterations 800 \
    --env.rewards.track-linear-velocity.weight 6
  uv run train Mjlab-Velocity-Flat-Unitree-Go1 --seed 1 --agent.run-name identified --agent.max-iterations 800 \
    --env.rewards.track-linear-velocity.weight 6 \
    --env.scene.entities.robot.overlay docs/benchmarks/sysid_go1.json
  uv run python tools/sysid_policy_proof.py evaluate WRONG.pt IDENTIFIED.pt --repeats 4

They decide it only if both policies walk in the model they were trained in; the table shows that too. In the identified
model the task's own rewards pay standing well, so the reward of linear velocity counts three times in both trainings.
With weak servos and more friction, policies of the identified model stood still.

The last command needs no GPU. It exports both checkpoints, runs them by ONNX Runtime, and writes the table
docs/benchmarks/sysid_policy.md.
"""

import argparse
import tempfile
from collections import deque
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import mujoco
import numpy as np
from mjlab import cli, load_task
from mjlab_deploy import Bundle, Policy, open_bundle
from mjlab_deploy.simulation.model_readings import ModelReadings
from mjlab_robots.go1 import GO1_DEFAULT_HEIGHT
from mjlab_scene import Scene
from mjlab_scene.models.overlay import read_overlay
from mjlab_sysid import Record, Robot, write_record

TASK = "Mjlab-Velocity-Flat-Unitree-Go1"
OVERLAY = Path(__file__).parents[1] / "docs/benchmarks/sysid_go1.json"
TIMESTEP, DELAY, PERIOD = 0.001, 42, 0.01  # [s], timesteps, [s] between the rows of a record
REAL: dict[str, dict[str, float]] = {
  "dof_armature": {"hip": 0.008, "thigh": 0.008, "calf": 0.018},
  "dof_frictionloss": {"hip": 0.2, "thigh": 0.2, "calf": 0.3},
  "dof_damping": {"hip": 0.1, "thigh": 0.1, "calf": 0.2},
}
"""Numbers of the real robot by field and kind of joint; in the model armature is 0.004 and 0.009, and the others 0."""
GAIN, SHANK = 1.6, 1.5
"""Stiffness of the real servos and mass of the real shanks, times those of the model."""
BOUNDS = {"armature": "=0.001..0.05", "frictionloss": "=0..4", "viscous_damping": "=0..2", "stiffness": ""}
TERMS = [
  f"{name}:.*_{kind}_joint{bounds},shared" for kind in ("hip", "thigh", "calf") for name, bounds in BOUNDS.items()
]
TERMS += ["body_mass:.*_calf,shared", "delay:.*=0..0.08,shared"]
NOISE, VELOCITY_NOISE, QUANTUM = 1e-3, 2e-2, 5e-4
"""Noise of encoders [rad, rad/s] and their resolution [rad]."""
COMMANDS = ((0.5, 0.0, 0.0), (1.0, 0.0, 0.0), (-0.5, 0.0, 0.0), (0.0, 0.5, 0.0), (0.0, 0.0, 0.5), (0.5, 0.0, 0.5))
PUSHES = (0.0, 0.5, 1.0)
"""Sizes of pushes [m/s], one kind for each episode, every 3 s in a random direction."""
SECONDS, PUSH_EVERY, FALL, SETTLE = 10.0, 3.0, np.radians(70.0), 1.0


def make_real(model: mujoco.MjModel, prefix: str = "") -> None:
  """Give a model of the Go1 the numbers of the real robot."""
  model.opt.timestep = TIMESTEP
  for i in range(model.njnt):
    joint = model.joint(i)
    kind = joint.name.removeprefix(prefix).removesuffix("_joint")[3:]
    for name, values in REAL.items():
      if kind in values:
        getattr(model, name)[joint.dofadr[0]] = values[kind]
  model.actuator_gainprm[:, 0] *= GAIN
  model.actuator_biasprm[:, 1] *= GAIN
  for leg in ("FR", "FL", "RR", "RL"):
    body = model.body(f"{prefix}{leg}_calf").id
    model.body_mass[body] *= SHANK
  mujoco.mj_setConst(model, mujoco.MjData(model))


def motion(robot: Robot, commands: np.ndarray, delay: float) -> np.ndarray:
  """Return positions and velocities of a robot's joints, (2, rows, joints), under late commands.

  Args:
    robot: The robot.
    commands: Target of each joint in each row, (rows, joints) [rad].
    delay: Time from a command to its effect [s].
  """
  model, data = robot.model, mujoco.MjData(robot.model)
  data.qpos[:] = robot.pose
  order = [robot.joints.index(model.actuator(i).name) for i in range(model.nu)]
  substeps, late = round(PERIOD / model.opt.timestep), round(delay / model.opt.timestep)
  held, rows = np.repeat(commands, substeps, 0)[:, order], []
  for step in range(len(held)):
    if step % substeps == 0:
      rows.append(np.stack((data.qpos, data.qvel)))
    data.ctrl[:] = held[max(0, step - late)]
    mujoco.mj_step(model, data)
  return np.stack(rows, 1)


def excitation(robot: Robot, seconds: float, random: np.random.Generator) -> np.ndarray:
  """Return commands of all joints, (rows, joints) [rad], sums of sines from the pose on."""
  joints = robot.joints
  times = PERIOD * np.arange(round(seconds / PERIOD))
  rate, phase = random.uniform(0.2, 3.0, (5, len(joints))), random.uniform(0.0, 2.0 * np.pi, (5, len(joints)))
  size = np.array([0.06 if "hip" in joint else 0.15 for joint in joints]) * random.uniform(0.5, 1.0, rate.shape)
  waves = size * (np.sin(2.0 * np.pi * rate * times[:, None, None] + phase) - np.sin(phase))
  return robot.pose + waves.sum(1)


def stand(overlay: Path | None = None) -> Robot:
  """Return the robot of the task, held by its base, with an overlay."""
  from mjlab.cli._sysid import RobotArguments, robot_of

  cfg = load_task(TASK).env
  cfg.scene.entities["robot"].overlay = None if overlay is None else str(overlay)
  return robot_of(cfg, RobotArguments())


def record(path: Path, seconds: float = 20.0) -> None:
  """Record the real robot on a stand, with all joints in motion."""
  robot, random = stand(), np.random.default_rng(0)
  make_real(robot.model)
  commands = excitation(robot, seconds, random)
  position, velocity = motion(robot, commands, DELAY * TIMESTEP)
  position = np.round((position + random.normal(0.0, NOISE, position.shape)) / QUANTUM) * QUANTUM
  velocity = velocity + random.normal(0.0, VELOCITY_NOISE, velocity.shape)
  signals = {"position_target": commands, "position": position, "velocity": velocity}
  times = PERIOD * np.arange(len(commands))
  write_record(Record(source=str(path), joints=robot.joints, time=times, signals=signals), path)


def walking_model(overlay: Path | None = None) -> mujoco.MjModel:
  """Return the model of the repository on the ground, with an overlay."""
  cfg = load_task(TASK).env
  cfg.scene.entities["robot"].overlay = None if overlay is None else str(overlay)
  scene = Scene(cfg.scene, cfg.decimation)
  cfg.sim.apply(scene.spec)
  model = scene.spec.compile()
  model.opt.timestep = TIMESTEP
  return model


def worlds(overlay: Path | None) -> dict[str, tuple[mujoco.MjModel, int]]:
  """Return model and delay in timesteps of each world in which a policy is evaluated, that of its training first."""
  real = walking_model()
  make_real(real, "robot/")
  delay = 0 if overlay is None else round(min(read_overlay(overlay).delay.values()) / TIMESTEP)
  return {"the model of its training": (walking_model(overlay), delay), "the real robot": (real, DELAY)}


class Walk:
  """Robot in MuJoCo C under the policy of a bundle, whose targets arrive `delay` timesteps late."""

  def __init__(self, bundle: Bundle, model: mujoco.MjModel, delay: int) -> None:
    self.policy, self.model, self.data, self._delay = Policy(bundle), model, mujoco.MjData(model), delay
    description = bundle.description
    self._readings = ModelReadings(model, description)
    (self._target,) = description.targets
    self._order = [self._target.joints.index(model.actuator(i).name.partition("/")[2]) for i in range(model.nu)]
    self._pose = np.array([joint.default_position for joint in description.robot.joints])
    self.period = description.timing.physics_dt * description.timing.decimation
    self._substeps = round(self.period / TIMESTEP)

  def episode(self, command: tuple[float, ...], push: float, seed: int) -> Iterator[tuple[np.ndarray, float]]:
    """Yield linear velocity, turning speed (vx, vy, wz) and tilt [rad] after every step of the policy."""
    data, model, random = self.data, self.model, np.random.default_rng(seed)
    mujoco.mj_resetData(model, data)
    data.qpos[:3], data.qpos[self._readings.qpos] = (0.0, 0.0, GO1_DEFAULT_HEIGHT + 0.03), self._pose
    late = deque([self._pose] * (self._delay + 1), maxlen=self._delay + 1)
    self.policy.reset()
    steps = round(SECONDS / self.period)
    every = round(PUSH_EVERY / self.period)
    for step in range(steps):
      if step and step % every == 0:
        angle = random.uniform(0.0, 2.0 * np.pi)
        data.qvel[:2] += push * np.array([np.cos(angle), np.sin(angle)])
      mujoco.mj_forward(model, data)
      readings = self._readings.read(data)
      readings["joint/position"] += random.normal(0.0, NOISE, self._pose.shape)
      readings["joint/velocity"] += random.normal(0.0, VELOCITY_NOISE, self._pose.shape)
      targets = self.policy.step({**readings, "command/velocity": np.array(command)}).targets[self._target.name]
      for _ in range(self._substeps):
        late.append(targets)
        data.ctrl[:] = late[0][self._order]
        mujoco.mj_step(model, data)
      twist = np.zeros(6)
      body = model.body("robot/trunk").id
      mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, twist, 1)
      tilt = float(np.arccos(np.clip(data.xmat[body, 8], -1.0, 1.0)))
      yield np.array([twist[3], twist[4], twist[2]]), tilt


def measure(walk: Walk, repeats: int) -> list[str]:
  """Return share of falls for each push, and root mean square errors of speed [m/s] and turning speed [rad/s]."""
  falls, errors = {push: [] for push in PUSHES}, []
  for push in PUSHES:
    for number, command in enumerate(COMMANDS * repeats):
      has_fallen, squares = False, []
      for step, (speeds, tilt) in enumerate(walk.episode(command, push, number)):
        if tilt > FALL:
          has_fallen = True
          break
        if step * walk.period >= SETTLE:
          squares.append((speeds - command) ** 2)
      falls[push].append(has_fallen)
      errors += squares
  linear = np.sqrt(np.mean([square[:2].sum() for square in errors]))
  turning = np.sqrt(np.mean([square[2] for square in errors]))
  return [*(f"{np.mean(falls[push]):.2f}" for push in PUSHES), f"{linear:.2f}", f"{turning:.2f}"]


def rows_of(label: str, overlay: Path | None, checkpoint: Path, repeats: int) -> list[tuple[str, ...]]:
  """Export a policy, let it walk in the model of its training and on the real robot; return rows of the table."""
  rows = []
  with tempfile.TemporaryDirectory() as folder:
    words = [str(checkpoint), "--output", f"{folder}/bundle", "--steps", "0"]
    if cli.export([*words, "--task", TASK] if not (checkpoint.parent / "manifest.json").exists() else words):
      raise SystemExit(1)
    with open_bundle(f"{folder}/bundle") as bundle:
      for world, (model, delay) in worlds(overlay).items():
        rows.append((label, world, *measure(Walk(bundle, model, delay), repeats)))
        print(rows[-1], flush=True)
  return rows


def evaluate(checkpoints: list[Path], repeats: int, output: Path) -> None:
  """Write the table of both policies, each evaluated in a process of its own."""
  with ProcessPoolExecutor() as pool:
    pairs = pool.map(rows_of, ("model as it is", "identified model"), (None, OVERLAY), checkpoints, [repeats] * 2)
    rows = [row for pair in pairs for row in pair]
  heads = ("trained on", "walks in", *(f"falls, pushes of {push:g} m/s" for push in PUSHES))
  heads += ("velocity error [m/s]", "turning error [rad/s]")
  lines = ["| " + " | ".join(cells) + " |" for cells in (heads, ["---"] * len(heads), *rows)]
  count = len(COMMANDS) * repeats
  text = f"""# A policy on a robot that is not its model

The real Go1 is MuJoCo C at 1 ms a step, with heavier rotors and shanks, friction, stiffer servos and a delay of
{DELAY} ms. `tools/sysid_policy_proof.py` has its numbers, the commands of the trainings, and made this table. Falls are
shares of {count} episodes of {SECONDS:g} s with {len(COMMANDS)} commands; errors are root mean squares until a fall. A
policy that does not walk in the model of its training decides nothing.

""" + "\n".join(lines)
  output.write_text(text + "\n", encoding="utf-8")
  print(text)


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  commands = parser.add_subparsers(dest="command", required=True)
  commands.add_parser("record").add_argument("path", type=Path)
  commands.add_parser("terms")
  compare = commands.add_parser("evaluate")
  compare.add_argument("checkpoints", type=Path, nargs=2)
  compare.add_argument("--repeats", type=int, default=8)
  compare.add_argument("--output", type=Path, default=Path("docs/benchmarks/sysid_policy.md"))
  args = parser.parse_args()
  if args.command == "record":
    record(args.path)
  elif args.command == "terms":
    print(*TERMS)
  else:
    evaluate(args.checkpoints, args.repeats, args.output)


if __name__ == "__main__":
  main()
