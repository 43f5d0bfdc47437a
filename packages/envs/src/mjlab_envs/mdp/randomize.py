"""Domain randomisation as an event."""

from typing import TYPE_CHECKING

import torch
from mjlab_dr import FIELDS, FieldRandomizer, RandomizeField
from mjlab_managers import EventTermCfg, ManagerTermBase, SceneEntityCfg

if TYPE_CHECKING:
  from mjlab_envs.env import ManagerBasedRlEnv

_ROBOT = SceneEntityCfg("robot")


class randomize(ManagerTermBase):
  """Draw new values of a field of an entity in masked worlds, always from the compiled default.

  The randomiser's pattern is matched against the names of the entity's own elements. Fields of MjModel become per-world
  by themselves; "encoder_bias" is the entity's own.
  """

  def __init__(self, cfg: EventTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    randomizer: FieldRandomizer = cfg.params["randomizer"]
    entity = env.scene[cfg.params["asset"].name]
    field, ix = FIELDS[randomizer.field], entity.indexing
    names, ids = list(ix.names[field.kind]), ix.ids[field.kind].tolist()
    if not field.in_model:
      # Joints with one column, and where it is among the entity's.
      one = [i for i, columns in enumerate(ix.q_of_joint) if len(columns) == 1]
      names, ids = [names[i] for i in one], [ix.q_of_joint[i][0] for i in one]
    self._field = RandomizeField(
      randomizer,
      env.sim,
      generator=env.rng,
      names=names,
      ids=ids,
      target=None if field.in_model else getattr(entity.data, randomizer.field),
      owner=f"entity '{entity.name}'",
    )
    self.needs_constants = randomizer.needs_constants

  def __call__(
    self,
    env: "ManagerBasedRlEnv",
    mask: torch.Tensor,
    *,
    randomizer: FieldRandomizer,
    asset: SceneEntityCfg = _ROBOT,
  ) -> None:
    del env, randomizer, asset  # Resolved at build.
    # The event manager recomputes derived fields once for all randomisers that fired.
    self._field.apply(mask, recompute=False)
