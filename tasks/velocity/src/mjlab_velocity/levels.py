"""Levels of randomised quantities: worlds take fixed values in turn instead of draws."""

from dataclasses import dataclass, replace
from typing import Any

import torch
from mjlab_core import ConfigError, require
from mjlab_core.names import check_name
from mjlab_dr import Categorical, FieldRandomizer, body_mass
from mjlab_dr.distributions import SampleFunction
from mjlab_envs import ManagerBasedRlEnvCfg, mdp


def in_turn(values: torch.Tensor, num_envs: int, block: int = 1) -> torch.Tensor:
  """Return the value of each world: world i has values[(i // block) mod len(values)]."""
  return values[torch.arange(num_envs, device=values.device) // block % len(values)]


@dataclass(frozen=True)
class ByWorld(Categorical):
  """Values that worlds take `in_turn` in every draw."""

  block: int = 1

  def prepared(self, *, device: torch.device, dtype: torch.dtype) -> SampleFunction:
    """Return a function of shapes with the worlds as first axis."""
    table = torch.tensor(self.values, device=device, dtype=dtype)

    def sample(shape: Any, *, generator: Any, device: torch.device, dtype: torch.dtype) -> torch.Tensor:
      del generator, device, dtype
      values = in_turn(table, shape[0], self.block)
      return values.reshape(-1, *(1,) * (len(shape) - 1)).expand(*shape)

    return sample


def set_level(cfg: ManagerBasedRlEnvCfg, name: str, values: tuple[float, ...], block: int) -> None:
  """Replace the draws of event `name` by `values` in turn, `ByWorld`, in place.

  The events "actuator_delay" and "payload" are made if they do not exist.

  Raises:
    ConfigError: There is no such event, or it draws nothing by a randomizer.
  """
  if cfg.events.get(name) is None or name == "actuator_delay":
    add_axis(cfg, name, values)
  event = cfg.events[name]
  assert event is not None
  wrong = f"event '{name}' draws nothing by a randomizer; those that do: {', '.join(_drawn(cfg))}"
  randomizer = require(event.params.get("randomizer"), FieldRandomizer, wrong)
  levels = {axis: ByWorld(values, block=block) for axis in randomizer.values}
  event.params = {**event.params, "randomizer": replace(randomizer, values=levels)}


def add_axis(cfg: ManagerBasedRlEnvCfg, name: str, values: tuple[float, ...]) -> None:
  """Draw "actuator_delay" [physics steps] or "payload" [kg on the torso] from `values`, in place.

  Raises:
    UnknownNameError: There is no such axis.
    ConfigError: The task has no event with the inertia of its torso.
  """
  check_name("event", name, [*_drawn(cfg), "actuator_delay", "payload"])
  if name == "actuator_delay":
    for actuator in actuators_of(cfg):
      actuator.delay_min_lag, actuator.delay_max_lag = 0, max(1, round(max(values)))
    cfg.events[name] = mdp.randomize_at_startup(
      FieldRandomizer(field="delay", pattern=".*", values={0: Categorical(values)})
    )
  else:
    randomizer = body_mass(torso_pattern(cfg), Categorical(values), operation="add")
    # It moves the same number.
    cfg.events["torso_inertia"] = None
    cfg.events[name] = mdp.randomize_at_startup(randomizer)


def torso_pattern(cfg: ManagerBasedRlEnvCfg) -> str:
  """Return the body with a randomised inertia.

  Raises:
    ConfigError: The task has no event that randomises it.
  """
  for name in ("base_com", "torso_inertia"):
    if (event := cfg.events.get(name)) is not None:
      return str(event.params["randomizer"].pattern)
  raise ConfigError("the task has no event 'base_com' or 'torso_inertia', which say where a payload is")


def _drawn(cfg: ManagerBasedRlEnvCfg) -> list[str]:
  return [name for name, event in cfg.events.items() if event is not None and "randomizer" in event.params]


def actuators_of(cfg: ManagerBasedRlEnvCfg) -> list[Any]:
  """Return the actuator configs of the robot."""
  articulation = cfg.scene.entities["robot"].articulation
  return [] if articulation is None else list(articulation.actuators)
