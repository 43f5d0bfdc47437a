"""Domain randomisation: one event for model fields, parameters of actuator models, and tensors of an entity."""

from collections.abc import Hashable
from typing import TYPE_CHECKING, Annotated, cast

import torch
from mjlab_actuators import ActuatorDelay, ActuatorParameter, ParameterName, Transmission
from mjlab_core import Ascending, Limits, MjlabError, require
from mjlab_dr import (
  FIELDS,
  Field,
  FieldRandomizer,
  Quantity,
  RandomizeField,
  element_names,
)
from mjlab_managers import EventTermCfg, ManagerTermBase, SceneEntityCfg

if TYPE_CHECKING:
  from mjlab_scene import Entity

  from mjlab_envs.env import ManagerBasedRlEnv

_ROBOT = SceneEntityCfg("robot")


class randomize(ManagerTermBase):
  """Draw new values of a row of `mjlab_dr.FIELDS` in masked worlds, relative to the compiled or configured default.

  The randomiser's pattern is matched against the names of the entity's own elements; `asset=None` takes the elements
  outside all entities: the ground with its material and light, and elements that the scene's `spec_fn` adds. Fields of
  MjModel become per-world automatically. "encoder_bias" needs an entity, options need `asset=None`. For "stiffness",
  "damping", "effort_limit" and "delay" of actuator models, the pattern matches driven targets of `transmission_type`.
  """

  def __init__(
    self,
    env: "ManagerBasedRlEnv",
    *,
    randomizer: FieldRandomizer,
    asset: SceneEntityCfg | None = _ROBOT,
    transmission_type: Transmission = "joint",
  ) -> None:
    super().__init__(env)
    entity = None if asset is None else env.scene[asset.name]
    field = FIELDS[randomizer.field]
    if transmission_type != "joint" and field.kind != "target":
      raise MjlabError(f"transmission_type is for quantities of actuator models; {randomizer.label} is not one")
    elements, target, prefix, owner = None, None, "", "scene"
    if entity is not None:
      prefix, owner = entity.prefix, f"entity '{entity.name}'"
      if field.kind == "target":
        target = _actuator_quantity(env, entity, randomizer, transmission_type)
      elif not field.in_model:
        target = getattr(entity.data, randomizer.field)
    elif not field.in_model:
      raise MjlabError(f"{randomizer.label} belongs to an entity, which asset=None is not")
    if field.kind not in ("option", "target"):
      elements = _of_the_scene(env, field) if entity is None else _elements(env, entity, field)
    self.field = RandomizeField(
      randomizer, env.sim, generator=env.rng, elements=elements, target=target, prefix=prefix, owner=owner
    )
    """The randomiser in the worlds of this environment."""
    self.claims: dict[Hashable, str] = {
      (name if name in FIELDS and FIELDS[name].in_model else prefix + name, element): description
      for (name, element), description in self.field.claims.items()
    }
    """Descriptions of the numbers that it writes; the event manager refuses a second writer."""
    self.needs_constants = self.field.needs_constants

  def __call__(self, mask: torch.Tensor) -> None:
    # The event manager recomputes derived fields once for all randomisers that fired.
    self.field.apply(mask, recompute=False)


class widen_randomization(ManagerTermBase):
  """Widen the ranges of a `randomize` event from the default to their full size.

  The strength grows from 0 to 1 between two numbers of environment steps, `steps`. It is logged, ().
  """

  def __init__(
    self,
    env: "ManagerBasedRlEnv",
    *,
    event: str,
    steps: Annotated[tuple[int, int], Limits(ge=0), Ascending(strict=True)],
  ) -> None:
    super().__init__(env)
    self._begin, self._end = steps
    # The term; its parts are made again when its parameters change.
    self._event = _randomize_event(env, event)
    _ = self._event.field.strength  # Some draws have no strength.
    if env.event_manager.get_term_cfg(event).mode == "startup":
      raise MjlabError(f"event '{event}' fires once, at startup, before its strength grows; give it another mode")
    self(env.reset_buf)

  def __call__(self, mask: torch.Tensor) -> torch.Tensor:
    del mask  # All worlds share the strength.
    share = (self.env.common_step_counter - self._begin) / (self._end - self._begin)
    return self._event.field.strength.copy_(share.clamp(0.0, 1.0)).clone()


class randomized_values(ManagerTermBase):
  """Return the values that a `randomize` event wrote, minus the compiled ones, (num_envs, number of values).

  For critics that observe parameters which the policy does not.
  """

  def __init__(self, env: "ManagerBasedRlEnv", *, event: str) -> None:
    super().__init__(env)
    self._event = _randomize_event(env, event)

  def __call__(self) -> torch.Tensor:
    field = self._event.field
    return (field.values() - field.default).float()


def randomize_at_startup(randomizer: FieldRandomizer) -> EventTermCfg:
  """Return an event that draws a field of the robot once, when the environment is built."""
  return EventTermCfg(randomize, mode="startup", params={"randomizer": randomizer})


def _randomize_event(env: "ManagerBasedRlEnv", event: str) -> randomize:
  term = env.event_manager.get_term_cfg(event).func
  return require(term, randomize, f"event '{event}' is not randomize")


def _actuator_quantity(
  env: "ManagerBasedRlEnv", entity: "Entity", randomizer: FieldRandomizer, transmission: Transmission
) -> Quantity:
  if not entity.is_actuated:
    raise MjlabError(f"entity '{entity.name}': {randomizer.label}: no actuators are configured for it")
  if randomizer.field == "delay":
    lo, hi = randomizer.values[0].support()
    return ActuatorDelay(entity.actuators, (int(lo), int(hi)), randomizer.pattern, transmission)
  name = cast("ParameterName", randomizer.field)
  return ActuatorParameter(entity.actuators, env.sim, name, randomizer.pattern, transmission)


def _elements(env: "ManagerBasedRlEnv", entity: "Entity", field: Field) -> dict[str, int]:
  """Return the ids of an entity's elements that have a field by name; for its own tensors, columns instead of ids."""
  ix = entity.indexing
  if not field.in_model:
    # Joints with one column, and where it is among the entity's.
    joints = zip(ix.names["joint"], ix.q_of_joint, strict=True)
    return {name: columns[0] for name, columns in joints if len(columns) == 1}
  if field.kind in ix.names:
    return dict(zip(ix.names[field.kind], ix.ids[field.kind].tolist(), strict=True))
  names = element_names(env.sim.mj_model, field.kind)
  return {name.removeprefix(entity.prefix): i for i, name in enumerate(names) if name.startswith(entity.prefix)}


def _of_the_scene(env: "ManagerBasedRlEnv", field: Field) -> dict[str, int]:
  """Return the ids of the elements that have a field and do not belong to an entity, by name."""
  prefixes = tuple(entity.prefix for entity in env.scene.entities.values())
  names = element_names(env.sim.mj_model, field.kind)
  return {name: i for i, name in enumerate(names) if not name.startswith(prefixes) and (field.kind, i) != ("body", 0)}
