"""Base of config dataclasses, and the names that their fields have in mjlab 1.x and Isaac Lab."""

from __future__ import annotations

import copy
import inspect
from functools import cache
from typing import TYPE_CHECKING, Any, NoReturn

from mjlab_core.errors import ConfigError, MjlabError
from mjlab_core.names import unknown

_EDITS = "put its configs into edits"

FORMER_FIELDS: dict[str, dict[str, str]] = {
  "ActionTermCfg": {
    "actuator_names": "actuators",
    "asset_name": "entity",
    "entity_name": "entity",
    "joint_names": "actuators",
    "transmission_type": "each transmission has its own class: JointPositionActionCfg, TendonLengthActionCfg, ...",
  },
  "ActuatorCfg": {
    "delay_per_env_phase": "worlds always change their delay at separate times",
    "joint_names_expr": "target_names_expr",
  },
  "CameraSensorCfg": {
    "camera_name": "camera",
    "clone_data": "images are the sensor's memory; observation terms copy them",
    "enabled_geom_groups": "geom_groups",
    "parent_body": "body",
  },
  "CommandTermCfg": {"asset_name": "entity", "entity_name": "entity", "viz": "drawings have fixed colours and sizes"},
  "ContactSensorCfg": {
    "debug": "debug_vis",
    "secondary_policy": "each secondary is reported by itself; name one, or None for anything",
  },
  "EntityArticulationCfg": {"actuator_cfgs": "actuators"},
  "EntityCfg": {
    "sort_actuators": "controls follow the order of the model; targets are given by joint, tendon or site",
    **dict.fromkeys(("lights", "cameras", "textures", "materials", "meshes", "geoms"), _EDITS),
  },
  "ManagerTermBaseCfg": {"name": "the key of the dict is the name of a term"},
  "MotionCommandCfg": {
    "adaptive_alpha": "adaptive=AdaptiveSamplingCfg(memory=...)",
    "adaptive_kernel_size": "adaptive=AdaptiveSamplingCfg(lookahead=...)",
    "adaptive_lambda": "adaptive=AdaptiveSamplingCfg(decay=...)",
    "adaptive_uniform_ratio": "adaptive=AdaptiveSamplingCfg(uniform_share=...)",
    "anchor_body_name": "anchor_body",
    "body_names": "bodies",
    "motion_file": "motion",
    "sampling_mode": "sampling",
  },
  "ObservationGroupCfg": {
    "concatenate_dim": "terms are joined along their last dimension, images along channels",
    "enable_corruption": "corrupt",
    "nan_check_per_term": "the message always names the term",
  },
  "RaySensorCfg": {
    "frame": "frames",
    "include_geom_groups": "geom_groups",
    "ray_alignment": "alignment",
    "viz": "drawings have fixed colours and sizes",
  },
  "RingPatternCfg": {"rings": "one ring: radius and num_samples; a custom RayPatternCfg may have several"},
  "RslRlBaseRunnerCfg": {
    "load_checkpoint": "mjlab train --resume",
    "load_run": "mjlab train --resume",
    "resume": "mjlab train --resume",
    "policy": "actor and critic",
  },
  "SceneEntityCfg": {
    f"{kind}_ids": f"give patterns or indices as {kind}_names" for kind in ("joint", "body", "geom", "site", "actuator")
  },
  "SensorCfg": {"update_latest_measurement": "sensors are read when they are asked for"},
  "SimulationCfg": {
    "ls_parallel": "the line search is always the engine's own",
    "mujoco": "its fields are those of SimulationCfg: SimulationCfg(timestep=..., iterations=...)",
  },
  "UniformVelocityCommandCfg": {
    "heading_command": "heading_fraction",
    "heading_control_stiffness": "heading_stiffness",
    "init_velocity_prob": "initial_velocity_fraction",
    "rel_forward_envs": "forward_fraction",
    "rel_heading_envs": "heading_fraction",
    "rel_standing_envs": "standing_fraction",
    "rel_world_envs": "world_fraction",
  },
}
"""New name of a field, or the way that took its place, by class and former name; subclasses included."""


class Config:
  """Base of config dataclasses. An unknown keyword is an error that names the nearest field, or the one it became.

  `lock` makes a config read-only.

  Raises:
    ConfigError: unknown keywords, all in one message.
  """

  if not TYPE_CHECKING:

    def __new__(cls, *args: Any, **kwargs: Any) -> Config:
      """Return a new instance, for `__init__` to fill."""
      known = _keywords(cls)
      if wrong := [name for name in kwargs if known is not None and name not in known]:
        raise ConfigError(*(_problem(cls, name, known) for name in wrong))
      return super().__new__(cls)

    def __setattr__(self, name: str, value: Any) -> None:
      advice, live = vars(self).get("_lock", ("", (name,)))
      if name not in live:
        raise MjlabError(advice)
      super().__setattr__(name, value)

  def __getstate__(self) -> dict[str, Any]:
    """Return the attributes of a copy, which is not read-only."""
    return {name: value for name, value in vars(self).items() if name != "_lock"}


class _LockedDict(dict[Any, Any]):
  """Read-only dictionary. A copy of it is a plain dictionary."""

  def __init__(self, items: dict[Any, Any], advice: str) -> None:
    super().__init__({key: lock(value, advice) for key, value in items.items()})
    self._advice = advice

  def _refuse(self, *_: Any, **__: Any) -> NoReturn:
    raise MjlabError(self._advice)

  __setitem__ = __delitem__ = __ior__ = clear = pop = popitem = setdefault = update = _refuse  # type: ignore[assignment]

  def __reduce_ex__(self, protocol: Any, /) -> Any:
    return dict, (dict(self),)


def lock(value: Any, advice: str, live: frozenset[str] = frozenset()) -> Any:
  """Return a read-only copy of a config, dictionary or list, also of those inside; any other value is returned itself.

  Args:
    value: the value. A read-only list is a tuple.
    advice: text of the error for a change. It names the call that makes the change.
    live: fields of the config that may still be assigned.
  """
  if type(value) is dict:
    return _LockedDict(value, advice)
  if type(value) is list:
    return tuple(lock(item, advice) for item in value)
  if not isinstance(value, Config) or "_lock" in vars(value):
    return value
  twin = copy.copy(value)
  vars(twin).update({name: lock(item, advice) for name, item in vars(twin).items()}, _lock=(advice, live))
  return twin


def write_locked(cfg: Config, **fields: Any) -> None:
  """Write fields of a read-only config, for its owner."""
  advice, _ = vars(cfg)["_lock"]
  vars(cfg).update({name: lock(value, advice) for name, value in fields.items()})


def _problem(cls: type, name: str, known: tuple[str, ...]) -> str:
  for base in cls.__mro__:
    if (new := FORMER_FIELDS.get(base.__name__, {}).get(name)) is not None:
      instead = f"it is called {new!r} here" if new.isidentifier() else new
      return f"{cls.__name__}: field {name!r} does not exist: {instead}. See docs/migration.md."
  return unknown("field", name, known, owner=cls.__name__)


@cache
def _keywords(cls: type) -> tuple[str, ...] | None:
  """Return the keywords that a class takes; None if it takes any."""
  parameters = list(inspect.signature(cls.__init__).parameters.values())[1:]
  if any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
    return None
  return tuple(parameter.name for parameter in parameters)
