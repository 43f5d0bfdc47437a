"""A trained policy that another learns from or begins as: read from its run, and held against where it is to act."""

import dataclasses
import hashlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from mjlab_core import unknown

from mjlab_rl.checkpoint import CheckpointError, Shapes, read_checkpoint, shapes_seen
from mjlab_rl.config import ConfigError, RslRlBaseRunnerCfg, RslRlDistillationRunnerCfg, RslRlModelCfg
from mjlab_rl.manifest import Json, PolicyRecord, RunManifest, encode, load_run

# What it may see with other noise, or later, than when it was trained.
_CORRUPTION = ("noise", "corrupt", "nan_policy")


@dataclasses.dataclass(kw_only=True)
class TrainedPolicy:
  """A trained policy; `read_trained_policy` makes one."""

  path: Path
  """Checkpoint that it is in."""
  weights: dict[str, Any]
  """State of its network, normaliser included."""
  shapes_seen: Shapes | None
  """Shapes of the observations that it saw; None: not known."""
  record: PolicyRecord | None
  """Where it is from; None: not known, of a distillation that is resumed without its manifest."""
  run: RunManifest | None
  """The run whose checkpoint it is in; None where there is no manifest."""
  role: str
  """Name of its network in that run: "actor", "student", or "teacher" where a distillation is resumed."""

  @property
  def name(self) -> str:
    """For messages."""
    return f"policy {self.path}" + (f" of {self.run.task}" if self.run is not None else "")

  def network(self, agent: RslRlDistillationRunnerCfg) -> RslRlModelCfg:
    """What its network is made of, from its run or from `agent.teacher`.

    Raises:
      ConfigError: Neither says, or one says other than the other.
    """
    if self.run is None:
      if agent.teacher is None:
        raise ConfigError(f"{self.name}: its run has no manifest, so agent.teacher must say what its network is")
      return agent.teacher
    trained: RslRlModelCfg = getattr(self.run.agent, self.role)
    if agent.teacher is not None and agent.teacher != trained:
      differences = _differences(_encoded(trained), _encoded(agent.teacher), "agent.teacher")
      raise ConfigError(
        f"{self.name}: {_listed(differences)}. Leave out agent.teacher to take what it was trained with."
      )
    return trained

  def check_beginning(self, env: Any, agent: RslRlBaseRunnerCfg) -> None:
    """Hold its network, and what it saw and did in training, against those of the policy of `agent` that begins as it.

    As `check`, but for the deviation of its actions.

    Raises:
      CheckpointError: Something differs; the message says what it was in training and what it is now.
    """
    self.check(env, agent, agent.policy)
    if self.run is not None:
      trained, now = (
        _encoded(dataclasses.replace(model, distribution_cfg=None))
        for model in (getattr(self.run.agent, self.role), getattr(agent, agent.policy))
      )
      self._refuse(_differences(trained, now, f"agent.{agent.policy}"))

  def check(self, env: Any, agent: RslRlBaseRunnerCfg, network: str = "teacher") -> None:
    """Hold what it saw and did in training against what it will: terms, their order and scales, actions, their period.

    Environment configurations are compared where they have `observations` by group, `actions`, `decimation` and
    `sim.timestep`; noise and delays may differ. Without a manifest only the shapes of weights are left to tell.

    Args:
      env: Configuration of the environment it is to act in.
      agent: Learner that it is to be part of.
      network: Which of its networks it is to be.

    Raises:
      CheckpointError: Something differs; the message says what it was in training and what it is now.
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
        # What is on one side alone is told by the order of terms.
        both = [key for key in trained if key in now]
        trained, now = ({key: side[key] for key in both} for side in (trained, now))
        differences += _differences(trained, now, f"observations.{own}")
    differences += _differences(_control(self.run.env), _control(env), "")
    differences += _differences(self.run.agent.clip_actions, agent.clip_actions, "agent.clip_actions")
    self._refuse(differences)

  def _refuse(self, differences: Iterable[str]) -> None:
    if listed := _listed(differences):
      raise CheckpointError(f"{self.name} does not fit: {listed}")


def read_trained_policy(path: Path, *, resumed: bool = False) -> TrainedPolicy:
  """The policy of a checkpoint, trained by reinforcement or distilled itself; runs no code of the file.

  Args:
    path: Checkpoint.
    resumed: Whether it is the checkpoint of a distillation that is to go on, and the teacher of that one is meant.

  Raises:
    CheckpointError: It cannot be read, or is of no distillation.
    ManifestError: The manifest of its run cannot be rebuilt.
  """
  try:
    run = load_run(path)
  except FileNotFoundError:
    run = None
  if resumed:
    state = read_checkpoint(path, "actor", "student")
    if "teacher_state_dict" not in state:
      raise CheckpointError(
        f"checkpoint {path} is of no distillation. A policy to imitate is not resumed but given as the teacher "
        "(--teacher)"
      )
    record = None if run is None else run.teacher
    return TrainedPolicy(
      path=path,
      weights=state["teacher_state_dict"],
      shapes_seen=shapes_seen(state, "teacher"),
      record=record,
      run=run,
      role="teacher",
    )
  roles = ("actor", "student") if run is None else (run.agent.policy,)
  state = read_checkpoint(path, *roles)
  role = next(name for name in roles if f"{name}_state_dict" in state)
  task = None if run is None else run.task
  with path.open("rb") as file:
    digest = hashlib.file_digest(file, "sha256").hexdigest()
  iterations = int(state["iter"]) + (0 if "mjlab" in state else 1)
  return TrainedPolicy(
    path=path,
    weights=state[f"{role}_state_dict"],
    shapes_seen=shapes_seen(state, role),
    record=PolicyRecord(checkpoint=str(path.resolve()), sha256=digest, task=task, iterations=iterations),
    run=run,
    role=role,
  )


def _observations(env: Any, group: str) -> dict[str, Json]:
  """What makes the numbers of a group: its terms and their order. Nothing where the configuration does not say."""
  groups = getattr(env, "observations", None)
  if groups is None:
    return {}
  encoded = _encoded(groups[group])
  terms = {name: term for name, term in encoded.pop("terms").items() if term is not None}
  return {"order of terms": list(terms), **encoded, **terms}


def _control(env: Any) -> Json:
  """What becomes of actions, and how often."""
  actions = getattr(env, "actions", None) or {}
  control: dict[str, Json] = {"order of actions": [name for name, action in actions.items() if action is not None]}
  control |= {name: encode(getattr(env, name, None)) for name in ("actions", "decimation")}
  control["sim.timestep"] = encode(getattr(getattr(env, "sim", None), "timestep", None))
  return _bare(control)


def _encoded(value: object) -> Any:
  return _bare(encode(value))


def _bare(data: Json) -> Json:
  """Fields of encoded dataclasses without their wrapping, so that a path into them reads as a flag does."""
  if isinstance(data, list):
    return [_bare(item) for item in data]
  if not isinstance(data, dict):
    return data
  if "$type" in data:
    fields = {key: _bare(value) for key, value in data["fields"].items() if not _is_corruption(key)}
    return {"type": data["$type"], **fields}
  if set(data) in ({"$tuple"}, {"$ref"}):
    return _bare(next(iter(data.values())))
  return {key: _bare(value) for key, value in data.items()}


def _is_corruption(field: str) -> bool:
  return field in _CORRUPTION or field.startswith("delay_")


def _differences(trained: Json, now: Json, where: str) -> Iterator[str]:
  """A line for every place where two encoded values differ."""
  if isinstance(trained, dict) and isinstance(now, dict):
    for key in [*trained, *(key for key in now if key not in trained)]:
      yield from _differences(trained.get(key), now.get(key), f"{where}.{key}" if where else key)
  elif trained != now:
    yield f"{where} was {_shown(trained)} in its training and is {_shown(now)} here"


def _shown(value: Json) -> str:
  if value is None:
    return "not there"
  if isinstance(value, list):
    return ", ".join(map(_shown, value))
  return value.get("type", ", ".join(value)) if isinstance(value, dict) else str(value)


def _listed(differences: Iterable[str]) -> str:
  found = list(differences)
  return "; ".join(found[:4]) + (f"; and {len(found) - 4} more" if len(found) > 4 else "")
