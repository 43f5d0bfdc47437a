"""Domain randomisation as an event."""

from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import torch
from mjlab_dr import FIELDS, Field, FieldRandomizer, RandomizeField, element_names
from mjlab_managers import CurriculumTermCfg, EventTermCfg, ManagerTermBase, ObservationTermCfg, SceneEntityCfg

if TYPE_CHECKING:
  from mjlab_scene import Entity

  from mjlab_envs.env import ManagerBasedRlEnv

_ROBOT = SceneEntityCfg("robot")


# Who writes what in each simulation: two randomisers of one number would undo each other's work in silence.
_writers: WeakKeyDictionary[object, dict[tuple[str, object], str]] = WeakKeyDictionary()


class randomize(ManagerTermBase):
  """Draw new values of a field of an entity in masked worlds, always from the compiled default.

  The randomiser's pattern is matched against the names of the entity's own elements; `asset=None` is what belongs to no
  entity: the ground with its material and light, and what the scene's `spec_fn` added. Fields of MjModel become
  per-world by themselves; "encoder_bias" is the entity's own; options belong to no entity.
  """

  def __init__(self, cfg: EventTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    randomizer: FieldRandomizer = cfg.params["randomizer"]
    asset: SceneEntityCfg | None = cfg.params["asset"]
    entity = None if asset is None else env.scene[asset.name]
    field = FIELDS[randomizer.field]
    if entity is None and not field.in_model:
      raise ValueError(f"{randomizer.label} belongs to an entity, which asset=None is not")
    owner = "scene" if entity is None else f"entity '{entity.name}'"
    prefix = "" if entity is None else entity.prefix
    names, ids = _of_the_scene(env, field) if entity is None else _elements(env, entity, field)
    self.field = RandomizeField(
      randomizer,
      env.sim,
      generator=env.rng,
      names=names,
      ids=ids,
      target=None if entity is None or field.in_model else getattr(entity.data, randomizer.field),
      prefix=prefix,
      owner=owner,
    )
    """The randomiser in the worlds of this environment."""
    written = _writers.setdefault(env.sim, {})
    whose = "" if field.in_model else prefix
    for (name, column), element in self.field.written().items():
      key = whose + name, column
      if key in written:
        raise ValueError(
          f"{owner}: {name} of {field.kind} '{element}' is written by two randomisers, {written[key]} "
          f"and {randomizer.label}; only one of them would count."
        )
      written[key] = randomizer.label
    self.needs_constants = randomizer.needs_constants

  @property
  def strength(self) -> torch.Tensor:
    """How far from the default what is written lies, as `RandomizeField.strength`, ()."""
    return self.field.strength

  def __call__(
    self,
    env: "ManagerBasedRlEnv",
    mask: torch.Tensor,
    *,
    randomizer: FieldRandomizer,
    asset: SceneEntityCfg | None = _ROBOT,
  ) -> None:
    del env, randomizer, asset  # Resolved at build.
    # The event manager recomputes derived fields once for all randomisers that fired.
    self.field.apply(mask, recompute=False)


class widen_randomization(ManagerTermBase):
  """Curriculum: what the event `event`, `randomize` or `randomize_actuator`, does grows from nothing to its ranges.

  The strength goes from 0 to 1 between two counts of environment steps, `steps`; it is what is logged, ().
  """

  def __init__(self, cfg: CurriculumTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    begin, end = cfg.params["steps"]
    if not 0 <= begin < end:
      raise ValueError(f"steps: must grow from 0 or more, got ({begin}, {end})")
    event = cfg.params["event"]
    term: Any = env.event_manager.get_term_cfg(event).func
    if not hasattr(type(term), "strength"):
      raise ValueError(f"event '{event}' randomises no field or gain: its function has no strength to be widened")
    self.strength: torch.Tensor = term.strength
    if env.event_manager.get_term_cfg(event).mode == "startup":
      raise ValueError(f"event '{event}' fires once, at startup, before anything has grown; give it another mode")
    self(env, env.reset_buf, **cfg.params)

  def __call__(
    self, env: "ManagerBasedRlEnv", mask: torch.Tensor, *, event: str, steps: tuple[int, int]
  ) -> torch.Tensor:
    del mask, event
    begin, end = steps
    return self.strength.copy_(((env.common_step_counter - begin) / (end - begin)).clamp(0.0, 1.0)).clone()


class randomized_values(ManagerTermBase):
  """What the `randomize` event `event` has written in each world, minus what was compiled, (num_envs, numbers written).

  For critics that may know what the policy has to feel.
  """

  def __init__(self, cfg: ObservationTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    self._field = randomizer_of(env, cfg.params["event"])

  def __call__(self, env: "ManagerBasedRlEnv", *, event: str) -> torch.Tensor:
    del env, event
    return (self._field.values() - self._field.default).float()


def randomize_at_startup(randomizer: FieldRandomizer) -> EventTermCfg:
  """The event that draws a field of the robot once, when the environment is built."""
  return EventTermCfg(randomize, mode="startup", params={"randomizer": randomizer})


def randomizer_of(env: "ManagerBasedRlEnv", event: str) -> RandomizeField:
  """The randomiser of the `randomize` event of that name, for curricula and observations of one's own.

  Raises:
    ValueError: there is no such event, or it is of another kind.
  """
  term = env.event_manager.get_term_cfg(event).func
  if not isinstance(term, randomize):
    raise ValueError(f"event '{event}' randomises no field: its function is no mdp.randomize")
  return term.field


def _elements(env: "ManagerBasedRlEnv", entity: "Entity", field: Field) -> tuple[list[str] | None, list[int] | None]:
  """Names of an entity's elements that a field is about, and their ids, or columns of the entity's own tensor."""
  if field.kind == "option":
    return None, None
  ix = entity.indexing
  if not field.in_model:
    # Joints with one column, and where it is among the entity's.
    one = [i for i, columns in enumerate(ix.q_of_joint) if len(columns) == 1]
    return [ix.names["joint"][i] for i in one], [ix.q_of_joint[i][0] for i in one]
  if field.kind in ix.names:
    return list(ix.names[field.kind]), ix.ids[field.kind].tolist()
  found = [
    (i, name) for i, name in enumerate(element_names(env.sim.mj_model, field.kind)) if name.startswith(entity.prefix)
  ]
  return [name.removeprefix(entity.prefix) for _, name in found], [i for i, _ in found]


def _of_the_scene(env: "ManagerBasedRlEnv", field: Field) -> tuple[list[str] | None, list[int] | None]:
  """Names of the elements that a field is about and that belong to no entity, and their ids."""
  if field.kind == "option":
    return None, None
  prefixes = tuple(entity.prefix for entity in env.scene.entities.values())
  names = element_names(env.sim.mj_model, field.kind)
  ids = [i for i, name in enumerate(names) if not name.startswith(prefixes) and (field.kind, i) != ("body", 0)]
  return [names[i] for i in ids], ids
