"""Environment for viewers that replays the stored steps of diverged environments."""

import numpy as np
from mjlab_sim import DivergedWorld, NanDump
from mjlab_viewer import Replay

# MuJoCo's limit for a bad state (mjMAXVAL).
_BOUND = 1e10


class NanReplay(Replay):
  """Replay of the stored physics steps and the result of the last; environments with fewer steps start later.

  A state that is not finite, or beyond 1e10, cannot be shown. The last state before it stays in the picture.

  Args:
    dump: Dump of a simulation.
    in_mujoco_c: Show the last steps as MuJoCo C computes them, instead of the recorded ones.
  """

  def __init__(self, dump: NanDump, *, in_mujoco_c: bool = False) -> None:
    self._worlds = dump.worlds
    steps = max(world.num_steps for world in dump.worlds) + 1
    worlds = [_states(world, steps, in_mujoco_c) for world in dump.worlds]
    self._stored = {name: np.stack([world[name] for world in worlds], 1) for name in worlds[0]}
    super().__init__(
      dump.model,
      {name: _shown(values) for name, values in self._stored.items()},
      dump.model.opt.timestep,
      {name: np.stack([world.model_fields[name] for world in dump.worlds]) for name in dump.worlds[0].model_fields},
    )

  def note(self, world: int) -> str:
    stored = self._worlds[world]
    step = max(0, self.at - (self.num_steps - 1 - stored.num_steps))
    when = f"world {stored.index} of the run, {stored.when(step)}"
    broken = [name for name, values in self._stored.items() if not _can_show(values[self.at, world]).all()]
    return f"{when}: {', '.join(broken)} not finite or beyond 1e10" if broken else when


def _states(world: DivergedWorld, steps: int, in_mujoco_c: bool) -> dict[str, np.ndarray]:
  """Return the fields of MjData that a dump has of one environment, (steps, ...)."""
  fields = world.states.copy()
  if in_mujoco_c:
    fields["qpos"] = np.concatenate((fields["qpos"][:1], world.replay().qpos))
  missing = steps - len(fields["time"])
  return {name: np.concatenate((np.repeat(values[:1], missing, 0), values)) for name, values in fields.items()}


def _can_show(values: np.ndarray) -> np.ndarray:
  return np.abs(values) <= _BOUND


def _shown(values: np.ndarray) -> np.ndarray:
  """Return values, (steps, ...), with each number that cannot be shown replaced by the last one that can."""
  shown = values.copy()
  for step, value in enumerate(values):
    shown[step] = np.where(_can_show(value), value, shown[step - 1] if step else 0.0)
  return shown
