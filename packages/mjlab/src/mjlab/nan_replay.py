"""The stored steps of worlds that diverged, as an environment that viewers can play."""

import numpy as np
from mjlab_sim import NanDump
from mjlab_viewer import Replay


class NanReplay(Replay):
  """Shows one stored physics step after another, and the result of the last; worlds with fewer wait at their first one.

  A state that is not finite cannot be shown: the last one that is stays.

  Args:
    dump: The worlds.
    in_mujoco_c: Show what MuJoCo C makes of the last steps instead of what was recorded.
  """

  def __init__(self, dump: NanDump, *, in_mujoco_c: bool = False) -> None:
    steps = max(world.num_steps for world in dump.worlds) + 1
    worlds = [_finite_states(dump, row, steps, in_mujoco_c) for row in range(len(dump.worlds))]
    super().__init__(
      dump.model,
      {name: np.stack([world[name] for world in worlds], 1) for name in worlds[0]},
      dump.model.opt.timestep,
      {name: np.stack([world.model_fields[name] for world in dump.worlds]) for name in dump.worlds[0].model_fields},
    )


def _finite_states(dump: NanDump, row: int, steps: int, in_mujoco_c: bool) -> dict[str, np.ndarray]:
  """The fields of MjData that a dump has of one world, (steps, ...)."""
  world = dump.worlds[row]
  fields = {name: np.concatenate((values, world.result[name][None])) for name, values in world.states.items()}
  if in_mujoco_c:
    fields["qpos"] = np.concatenate((fields["qpos"][:1], world.replay().qpos))
  missing = steps - len(fields["time"])
  fields = {name: np.concatenate((np.repeat(values[:1], missing, 0), values)) for name, values in fields.items()}
  for values in fields.values():
    for step in range(steps):
      values[step] = np.where(np.isfinite(values[step]), values[step], values[step - 1] if step else 0.0)
  return fields
