"""Trained policies as teachers or beginnings of a run, and their comparison with the new run."""

import dataclasses
import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mjlab_core import require, unknown
from mjlab_core.errors import ConfigError, FileError

from mjlab_rl.config import RslRlBaseRunnerCfg, RslRlDistillationRunnerCfg, RslRlModelCfg
from mjlab_rl.runs.checkpoint import Shapes, check_finite, read_checkpoint, refuse, shapes_seen
from mjlab_rl.runs.encoding import Json, encode
from mjlab_rl.runs.manifest import PolicyRecord, RunManifest, load_run

# Fields of observations that may differ from the training.
_CORRUPTION = ("noise", "corrupt", "nan_policy")


@dataclasses.dataclass(kw_only=True)
class TrainedPolicy:
  """Trained policy; `read_trained_policy` makes one."""

  path: Path
  """Its checkpoint."""
  weights: dict[str, Any]
  """State of its network, normaliser included."""
  shapes_seen: Shapes | None
  """Shapes of its observations; None: not known."""
  record: PolicyRecord | None
  """Its origin; None for a resumed distillation without a manifest."""
  run: RunManifest | None
  """Run of its checkpoint; None without a manifest."""
  role: str
  """Name of its network in that run: "actor", "student", or "teacher" for a resumed distillation."""

  @property
  def name(self) -> str:
    """Name for messages."""
    return f"policy {self.path}" + (f" of {self.run.task}" if self.run is not None else "")

  def network(self, agent: RslRlDistillationRunnerCfg) -> RslRlModelCfg:
    """Return the config of its network, from its run or from `agent.teacher`.

    Raises:
      ConfigError: Both are missing, or they differ.
    """
    if self.run is None:
      missing = f"{self.name}: its run has no manifest; agent.teacher must describe its network"
      return require(agent.teacher, RslRlModelCfg, missing)
    trained: RslRlModelCfg = getattr(self.run.agent, self.role)
    if agent.teacher is not None and agent.teacher != trained:
      differences = _differences(_encoded(trained), _encoded(agent.teacher), "agent.teacher")
      hint = (
        "Several teachers must have the same network"
        if agent.num_teachers > 1
        else ("Leave out agent.teacher to use the network of its training")
      )
      refuse(self.name, differences, f". {hint}", ConfigError)
    return trained

  def check_beginning(self, env: Any, agent: RslRlBaseRunnerCfg) -> None:
    """Compare its network, observations and actions with those of the policy of `agent`, which starts from it.

    The standard deviation of actions may differ.

    Raises:
      FileError: Something differs; the message gives both values.
    """
    self.check(env, agent, agent.policy)
    if self.run is not None:
      trained, now = (
        _encoded(dataclasses.replace(model, distribution_cfg=None))
        for model in (getattr(self.run.agent, self.role), getattr(agent, agent.policy))
      )
      refuse(self.name, _differences(trained, now, f"agent.{agent.policy}"))

  def check(self, env: Any, agent: RslRlBaseRunnerCfg, network: str = "teacher") -> None:
    """Compare observations and actions of its training with those of a new run: terms, order, scales, period.

    `observations`, `actions`, `decimation` and `sim.timestep` of environment configurations are compared if they exist;
    noise and delays may differ. Without a manifest nothing is compared here.

    Args:
      env: Configuration of the new environment.
      agent: Configuration of the new learner.
      network: Network of the learner that the policy becomes.

    Raises:
      FileError: Something differs; the message gives both values.
    """
    if self.run is None:
      return
    theirs, ours = self.run.agent.obs_groups[self.role], agent.obs_groups[network]
    differences = list(_differences(len(theirs), len(ours), "number of observation groups"))
    for group, own in zip(theirs, ours, strict=False):
      groups = getattr(env, "observations", None)
      if groups is not None and groups.get(own) is None:
        differences.append(unknown("observation group", own, [name for name in groups if groups[name] is not None]))
      else:
        trained, now = _observations(self.run.env, group), _observations(env, own)
        differences += _differences(trained, now, f"observations.{own}")
    differences += _differences(_control(self.run.env, self.run.agent), _control(env, agent), "")
    refuse(self.name, differences)


def read_trained_policy(path: Path, *, resumed: bool = False) -> TrainedPolicy:
  """Return the policy of a checkpoint, of reinforcement learning or distillation, without running code of the file.

  Args:
    path: Checkpoint.
    resumed: Return the teacher of a distillation instead, to resume it.

  Raises:
    FileError: The checkpoint or the manifest of its run cannot be read, or there is no teacher in it.
  """
  try:
    run = load_run(path)
  except FileNotFoundError:
    run = None
  roles = ("actor", "student") if resumed or run is None else (run.agent.policy,)
  state = read_checkpoint(path, *roles)
  role = "teacher" if resumed else next(name for name in roles if f"{name}_state_dict" in state)
  if state.get(f"{role}_state_dict") is None:
    raise FileError(f"checkpoint {path} has no teacher, so it is not a distillation to resume")
  check_finite(path, role, state[f"{role}_state_dict"])
  record = None if run is None else run.teacher
  if not resumed:
    with path.open("rb") as file:
      digest = hashlib.file_digest(file, "sha256").hexdigest()
    record = PolicyRecord(
      checkpoint=str(path.resolve()),
      sha256=digest,
      task=None if run is None else run.task,
      iterations=int(state["iter"]) + (0 if state.get("mjlab") else 1),
    )
  return TrainedPolicy(
    path=path,
    weights=state[f"{role}_state_dict"],
    shapes_seen=shapes_seen(state, role),
    record=record,
    run=run,
    role=role,
  )


def _observations(env: Any, group: str) -> dict[str, Json]:
  """Return the terms of an observation group and their order; empty if the configuration has none."""
  groups = getattr(env, "observations", None)
  if groups is None:
    return {}
  encoded = _encoded(groups[group])
  terms = {name: term for name, term in encoded.pop("terms").items() if term is not None}
  return {"order of terms": list(terms), **encoded, **terms}


def _control(env: Any, agent: RslRlBaseRunnerCfg) -> Json:
  """Return the actions, their order, period and limit."""
  actions = getattr(env, "actions", None) or {}
  control = {
    "order of actions": [name for name, action in actions.items() if action is not None],
    "actions": actions,
    "decimation": getattr(env, "decimation", None),
    "sim.timestep": getattr(getattr(env, "sim", None), "timestep", None),
    "agent.clip_actions": agent.clip_actions,
  }
  return _encoded(control)


def _encoded(value: object) -> Any:
  return _bare(encode(value))


def _bare(data: Json) -> Json:
  """Return encoded data without tags, so that paths into it look like flags."""
  match data:
    case list():
      return [_bare(item) for item in data]
    case {"$tuple": inner} | {"$ref": inner}:
      return _bare(inner)
    case {"$type": kind, "fields": fields}:
      return {"type": kind} | {name: _bare(value) for name, value in fields.items() if not _is_corruption(name)}
    case dict():
      return {key: _bare(value) for key, value in data.items()}
  return data


def _is_corruption(field: str) -> bool:
  return field in _CORRUPTION or field.startswith("delay_")


def _differences(trained: Json, now: Json, where: str) -> Iterator[str]:
  """Yield a line for each difference between two encoded values."""
  if isinstance(trained, dict) and isinstance(now, dict):
    for key in [*trained, *(key for key in now if key not in trained)]:
      yield from _differences(trained.get(key), now.get(key), f"{where}.{key}" if where else key)
  elif trained != now:
    yield f"{where} was {_shown(trained)} in its training and is {_shown(now)} here"


def _shown(value: Json) -> str:
  match value:
    case None:
      return "not there"
    case list():
      return ", ".join(map(_shown, value))
    case dict():
      return value.get("type", ", ".join(value))
  return str(value)
