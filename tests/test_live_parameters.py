"""Changes of every parameter of every term of every task by `set_params` act or are refused."""

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import mjlab
import pytest
import torch
from mjlab_core.errors import MjlabError
from mjlab_envs import ManagerBasedRlEnv
from mjlab_managers import ManagerBase, SceneEntityCfg
from mjlab_managers.terms.binding import Term
from mjlab_sensors import CameraSensorCfg

WORLDS = 4
STEPS = 6

STEPS_OF_NUMBERS = (
  *((1.5, 0.0), (1.0, 0.1), (0.5, 0.0), (0.0, 0.0), (1.0, -0.1)),
  *((1e-3, 0.0), (1e3, 0.0), (-1.0, 0.0), (1.0, 1e3)),
)
"""Factors and offsets of changed numbers, the smallest changes first."""

UNSEEN: dict[str, str] = {
  "illegal_contact.threshold": "nothing touches with a force between the values",
  "held.hold": "no object is at its goal",
  "time_to_success.hold": "no object is at its goal",
  "dropped.low": "no object was lifted",
  "reward_curriculum.steps_per_iteration": "no stage begins within so few steps",
}
"""Parameters, "function.parameter", whose change cannot be seen here, with the reason."""

RECORDED: dict[str, str] = {
  **dict.fromkeys(("held.hold", "time_to_success.hold"), "a number of steps, counted on the host"),
  **dict.fromkeys(
    ("variable_posture.walking_threshold", "variable_posture.running_threshold"), "compared with each other on the host"
  ),
  **dict.fromkeys(("feet_clearance.threshold", "feet_clearance.target", "height_scan.offset"), "used in __init__"),
  "upright_on_terrain.std": "used in __init__",
}
"""Numbers whose change needs a new recording, with the reason."""


def leaves(value: Any) -> Iterator[torch.Tensor]:
  if isinstance(value, torch.Tensor):
    yield value
  elif isinstance(value, Mapping):
    for part in value.values():
      yield from leaves(part)


def differ(a: Any, b: Any) -> bool:
  one, other = list(leaves(a)), list(leaves(b))
  return any(
    x.shape != y.shape or not torch.equal(x.nan_to_num(), y.nan_to_num()) for x, y in zip(one, other, strict=True)
  )


def changed(value: Any, factor: float, offset: float) -> Any:
  """Return a parameter with every number in it changed, whole ones by whole numbers."""
  if isinstance(value, bool) or value is None:
    return value
  if isinstance(value, int):
    return int(value * factor + (offset > 0.0) - (offset < 0.0))
  if isinstance(value, float):
    return value * factor + offset
  if isinstance(value, Mapping):
    return {key: changed(part, factor, offset) for key, part in value.items()}
  if isinstance(value, list | tuple):
    return type(value)(changed(part, factor, offset) for part in value)
  if dataclasses.is_dataclass(value) and not isinstance(value, type | SceneEntityCfg):
    fields = {field.name: changed(getattr(value, field.name), factor, offset) for field in dataclasses.fields(value)}
    return dataclasses.replace(value, **fields)  # type: ignore[type-var]
  return value


def candidates(value: Any) -> list[Any]:
  """Other values of a parameter, the nearest first; a name that does not exist must be refused."""
  if isinstance(value, bool):
    return [not value]
  if isinstance(value, str):
    return ["no_such_name"]
  if isinstance(value, SceneEntityCfg):
    return [SceneEntityCfg("no_such_entity")]
  if isinstance(value, list | tuple) and any(isinstance(part, str) for part in value):
    return [type(value)(["no_such_name"])]
  found = []
  for factor, offset in STEPS_OF_NUMBERS:
    with contextlib.suppress(MjlabError):  # Some parameters check themselves.
      found.append(changed(value, factor, offset))
  return found


def functions(cfg: Any) -> Iterator[str]:
  """Yield the name of the function or class of each term in a config."""
  groups = [group.terms for group in cfg.observations.values() if group is not None]
  for terms in (*groups, cfg.rewards, cfg.terminations, cfg.events, cfg.curriculum, cfg.metrics, cfg.recorders):
    yield from (term.func.__name__ for term in terms.values() if term is not None)


class Sweep:
  """Changes of all parameters of one environment."""

  def __init__(self, env: ManagerBasedRlEnv) -> None:
    self.env = env
    generator = torch.Generator().manual_seed(0)
    shape = (STEPS, env.num_envs, env.action_manager.total_action_dim)
    self.actions = torch.randn(shape, generator=generator)
    env.reset(seed=0)
    for action in self.actions:
      env.step(action)
    self.state = env.state_dict()
    self.recaptures: list[str] = []
    setattr(env, "request_recapture", self.recaptures.append)  # noqa: B010
    self.unchanged: dict[tuple[str, str], Any] = {}

  def called(self, manager: ManagerBase[Any], name: str) -> Any:
    """Return what one call of a term gives and leaves, from the saved state."""
    env, term = self.env, manager.term(name)
    env.load_state_dict(self.state)
    worlds = torch.arange(env.num_envs)
    args = [] if not manager.masked else [worlds if term.wants_ids else worlds >= 0]
    value = term(*args)
    kept = {key: part.clone() for key, part in enumerate(leaves(value))}
    return kept, env.state_dict()

  def run(self) -> Any:
    """Return what a few steps give and leave, from the saved state, with episodes that end in the middle."""
    env = self.env
    env.load_state_dict(self.state)
    outputs = []
    for step, action in enumerate(self.actions):
      if step == 2:
        env.episode_length_buf[::2] = env.max_episode_length - 1
      *output, _ = env.step(action)
      outputs.append(output)
    rewards, metrics = env.reward_manager.step_reward.clone(), env.metrics_manager.state_dict()
    tensors = {i: dict(enumerate(output)) for i, output in enumerate(outputs)}
    return tensors, rewards, metrics, env.state_dict()

  def acts(self, part: str, manager: ManagerBase[Any], name: str, param: str) -> tuple[str, bool]:
    """Return "acts", "raises" or "silent" for a parameter, and whether a number asked for a new recording."""
    value = manager.term(name).given[param]
    outcomes: list[str] = []
    records = False
    for new in candidates(value):
      if new is value or new == value:
        continue
      undo = manager.remember()
      self.recaptures.clear()
      try:
        manager.set_params(name, **{param: new})
      except MjlabError:
        outcomes.append("raises")
        continue
      records |= isinstance(value, float) and bool(self.recaptures)
      try:
        outcome = "acts" if self.differs(part, manager, name, in_run=not outcomes) else "silent"
      except MjlabError:
        outcome = "raises"
      undo()
      if outcome == "acts":
        return outcome, records
      outcomes.append(outcome)
    return ("silent" if "silent" in outcomes else "raises" if outcomes else "none"), records

  def differs(self, part: str, manager: ManagerBase[Any], name: str, *, in_run: bool) -> bool:
    """Return whether a call, or a run, gives or leaves something else than before the change."""
    if differ(dict(enumerate(self.called(manager, name))), self.unchanged[part, name]):
      return True
    return in_run and differ(dict(enumerate(self.run())), self.unchanged["", ""])

  def prepare(self, part: str, manager: ManagerBase[Any], name: str) -> None:
    """Note the outcome of a term as it is."""
    if ("", "") not in self.unchanged:
      self.unchanged["", ""] = dict(enumerate(self.run()))
    self.unchanged[part, name] = dict(enumerate(self.called(manager, name)))


@pytest.mark.slow
def test_a_changed_parameter_acts_or_is_refused() -> None:
  found: dict[str, str] = {}
  records: dict[str, bool] = {}
  seen: set[str] = set()
  # Where robots walk, most parameters act at once; rough ground is slow.
  for task in sorted(mjlab.list_tasks(), key=lambda task: ("Rough" in task, "Velocity" not in task)):
    cfg = mjlab.load_task(task).env
    kinds = set(functions(cfg))
    pending = {key.split(".")[0] for key, outcome in found.items() if outcome == "silent" and key not in UNSEEN}
    if kinds <= seen - pending:
      continue
    seen |= kinds
    cfg.scene.num_envs = WORLDS
    for sensor in cfg.scene.sensors.values():
      if isinstance(sensor, CameraSensorCfg):
        sensor.width = sensor.height = 8  # A drawing takes longer than all else.
    with ManagerBasedRlEnv(cfg, device="cpu") as env:
      sweep = Sweep(env)
      for part, manager in env.managers.items():
        for name, term in list(manager._terms.items()):
          if not isinstance(term, Term):
            continue
          kind = getattr(term.cfg.func, "__name__", type(term.func).__name__)
          wanted = [param for param in term.given if found.get(f"{kind}.{param}", "silent") == "silent"]
          if wanted:
            sweep.prepare(part, manager, name)
          for param in wanted:
            key = f"{kind}.{param}"
            outcome, recorded = sweep.acts(part, manager, name, param)
            found[key] = outcome
            records[key] = records.get(key, False) or recorded
  assert {key for key, outcome in found.items() if outcome == "silent"} == set(UNSEEN)
  assert {key for key, recorded in records.items() if recorded} == set(RECORDED)
