"""Verification of a bundle: replay of its record, and its policy in MuJoCo C compared with the recorded trajectory."""

from dataclasses import dataclass, field

import numpy as np

from mjlab_deploy.arrays import Arrays
from mjlab_deploy.bundle import Bundle
from mjlab_deploy.description import ACTION
from mjlab_deploy.errors import DeployError, reading
from mjlab_deploy.policy import Policy
from mjlab_deploy.simulation.closed_loop import ClosedLoop

TOLERANCE = 1e-4
"""Largest error of observations, actions and targets, relative to 1 + |value|."""
STEPS = 100
"""Steps for which the closed loop must follow the recorded trajectory."""
DRIFT = 1e-4
"""Largest error of joint positions in these steps [rad, m]."""
FALLEN = 1.2
"""Tilt at which a floating robot has fallen [rad]."""


@dataclass
class Report:
  """Result of `verify`."""

  failures: list[str] = field(default_factory=list)
  """A line for each check that failed."""
  notes: list[str] = field(default_factory=list)
  """A line for each check that passed, or could not be made."""

  @property
  def passed(self) -> bool:
    """True if no check failed."""
    return not self.failures


def verify(bundle: Bundle) -> Report:
  """Replay the record of a bundle, then run its policy in MuJoCo C from the same state.

  Raises:
    DeployError: The bundle has no record, or one that does not fit.
  """
  if bundle.description.golden is None:
    raise DeployError("the bundle has no golden.npz; export it again with --steps above 0")
  golden, steps, report = bundle.arrays("golden.npz"), bundle.description.golden.steps, Report()
  wanted = ["action", "episode_start", *(f"input/{item.name}" for item in bundle.description.inputs)]
  for name in [*wanted, *(target.name for target in bundle.description.targets)]:
    if name not in golden or len(golden[name]) != steps:
      raise DeployError(f"golden.npz: {name[:60]!r} is missing or has not {steps} steps")
  _replay(bundle, golden, report)
  if report.passed:
    _run_beside(bundle, golden, bundle.description.golden.engine, report)
  return report


def _inputs(bundle: Bundle, golden: Arrays, step: int) -> dict[str, np.ndarray]:
  return {item.name: golden[f"input/{item.name}"][step] for item in bundle.description.inputs}


def _replay(bundle: Bundle, golden: Arrays, report: Report) -> None:
  policy, worst = Policy(bundle), 0.0
  steps = len(golden["action"])
  for step in range(steps):
    if golden["episode_start"][step]:
      policy.reset()
    result = policy.step(_inputs(bundle, golden, step))
    # In the order of computation, so that the first that differs is the cause.
    pairs = []
    for term in bundle.description.observations:
      name = f"observation/{term.group}"
      if name in golden:
        ours, theirs = term.part(result.observations[term.group]), term.part(golden[name][step])
        pairs.append((f"observation '{term.group}/{term.name}'", ours, theirs))
    pairs.append(("action", result.action, golden[ACTION][step]))
    pairs += [(f"'{name}'", value, golden[name][step]) for name, value in result.targets.items()]
    for where, ours, theirs in pairs:
      if ours.shape != theirs.shape:
        raise DeployError(f"golden.npz: {where} has shape {theirs.shape}, the policy's is {ours.shape}")
      error = np.abs(ours.astype(float) - theirs) / (1.0 + np.abs(theirs))
      worst = max(worst, float(error.max(initial=0.0)))
      if not (error <= TOLERANCE).all():
        column = int(np.argmax(np.nan_to_num(error, nan=np.inf)))
        values = f"column {column} is {ours.flat[column]:.6g}, recorded {theirs.flat[column]:.6g}"
        report.failures.append(f"replay: {where} differs first, in step {step}: {values}")
        return
    policy.replace_last_action(golden[ACTION][step])
  report.notes.append(f"replay: {steps} steps of golden.npz, largest error {worst:.1e} (allowed {TOLERANCE:.0e})")


def _run_beside(bundle: Bundle, golden: Arrays, engine: str, report: Report) -> None:
  if not bundle.description.has_scene or "state/qpos" not in golden:
    report.notes.append("closed loop: not run, the bundle has no scene")
    return
  loop, policy = ClosedLoop(bundle), Policy(bundle)
  known = {item.name for item in loop.sensors.inputs}
  replayed = [item.name for item in bundle.description.inputs if item.name not in known]
  starts = np.flatnonzero(golden["episode_start"])
  # Only the first episode, because MuJoCo C cannot repeat the resets of the training.
  end = int(starts[1]) if len(starts) > 1 else len(golden["action"])
  with reading("golden.npz does not fit scene.xml", ValueError, LookupError):
    loop.start(golden["state/qpos"][0].astype(float), golden["state/qvel"][0].astype(float))
  drift, fallen, columns = 0.0, None, loop.sensors.qpos
  for step in range(end):
    if step < STEPS:
      error = np.abs(loop.data.qpos[columns] - golden["state/qpos"][step][columns])
      drift = max(drift, float(error.max(initial=0.0)))
    if not np.isfinite(loop.data.qpos).all() or (bundle.description.robot.is_floating and loop.tilt > FALLEN):
      fallen = step
      break
    loop.step(policy.step(_inputs(bundle, golden, step) | loop.readings()).targets)
  steps = min(STEPS, end)
  line = f"closed loop: joint positions within {drift:.1e} of the training's for {steps} steps (allowed {DRIFT:.0e})"
  if drift > DRIFT and engine == "native":
    report.failures.append(line)
  else:
    report.notes.append(line if drift <= DRIFT else f"{line}; not required of a record of the {engine} engine")
  if fallen is not None:
    report.failures.append(f"closed loop: fell in step {fallen}; the training's robot stood for {end} steps")
  else:
    report.notes.append(f"closed loop: stood for all {end} steps of the recorded episode")
  if own := [name for name in replayed if not name.startswith(("command/", "motion/"))]:
    report.notes.append(
      f"closed loop: {', '.join(own)} came from the record, because MuJoCo C alone has no such reading"
    )
