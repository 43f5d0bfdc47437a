"""Networks of others, from observations to actions, behind the inputs and outputs of a bundle's graph.

They are ONNX files with the metadata of mjlab 1.x and of BeyondMimic: names of joints and observations, scales, clips,
histories, default pose and action scale. Observations are assembled here, in NumPy.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from mjlab_deploy.errors import DeployError, check_known

GROUP = "actor"
"""Name of the only observation group."""
_SIX = (0, 1, 3, 4, 6, 7)
"""Entries of a rotation matrix, row by row, that are its first two columns."""


@dataclass(frozen=True)
class Term:
  """Observation of a network."""

  name: str
  sources: tuple[str, ...]
  """Readings, or "last_action"."""
  width: int
  """Length of one frame."""
  scale: np.ndarray
  clip: tuple[float, float] | None
  history: int
  """Frames; 1 without a history."""

  @property
  def memory(self) -> str:
    """Name of the memory of its history."""
    return f"memory/history/{GROUP}/{self.name}"


class NetworkGraph:
  """A network as a graph from readings to joint targets, with the methods of ONNX Runtime's session.

  Args:
    session: Session of the network.

  Raises:
    DeployError: Metadata is missing, or an observation is not known; the message names it.
  """

  def __init__(self, session: Any) -> None:
    self._session = session
    self._metadata: Mapping[str, str] = session.get_modelmeta().custom_metadata_map
    self._inputs = {item.name: [n if isinstance(n, int) else 1 for n in item.shape] for item in session.get_inputs()}
    self._outputs = [item.name for item in session.get_outputs()]
    # Trainers agree on "obs", not on the output: rsl-rl writes "actions", MuJoCo Playground "continuous_actions".
    self._action = "actions" if "actions" in self._outputs or len(self._outputs) != 1 else self._outputs[0]
    if "obs" not in self._inputs or self._action not in self._outputs:
      takes, returns = (", ".join(names)[:120] for names in (self._inputs, self._outputs))
      raise DeployError(f"the network must take 'obs' and return 'actions'; it takes {takes} and returns {returns}")
    self.joints = tuple(self.words("joint_names"))
    count = len(self.joints)
    self.default, self.stiffness, self.damping, self.action_scale = (
      self._row(key, count) for key in ("default_joint_pos", "joint_stiffness", "joint_damping", "action_scale")
    )
    self.follows_clip = "joint_pos" in self._outputs and "time_step" in self._inputs
    self.anchor = self._metadata.get("anchor_body_name", "")
    self.states = {
      name: f"{name[:-3]}_out" for name in self._inputs if name.endswith("_in") and f"{name[:-3]}_out" in self._outputs
    }
    for name in self._inputs:
      check_known("meaning of the network's input", name, ("obs", "time_step", *self.states))
    self.terms = self._terms()
    if (width := sum(term.width * term.history for term in self.terms)) != self._inputs["obs"][-1]:
      raise DeployError(f"its observation_names give {width} numbers, the network takes {self._inputs['obs'][-1]}")

  def words(self, key: str) -> list[str]:
    """Return a list of the metadata.

    Raises:
      DeployError: It is missing.
    """
    check_known("metadata of the network", key, self._metadata)
    return [word.strip() for word in self._metadata[key].split(",")]

  def _row(self, key: str, count: int) -> np.ndarray:
    values = _numbers(key, self.words(key))
    if len(values) not in (1, count):
      raise DeployError(f"metadata '{key}' has {len(values)} numbers for {count} joints")
    return np.resize(values, count)

  def _terms(self) -> list[Term]:
    found = []
    names = self.words("observation_names")
    columns = {
      key: self._metadata.get(f"observation_terms_{key}", "").split(separator)
      for key, separator in (("scale", ";"), ("clip", ";"), ("history_length", ","))
    }
    for i, name in enumerate(names):
      scale, clip, history = (parts[i].strip() if len(parts) == len(names) else "" for parts in columns.values())
      sources, width = self._meaning(name)
      limits = _numbers("observation_terms_clip", clip.strip("()[]").split(",")) if clip not in ("", "None") else None
      if limits is not None and len(limits) != 2:
        raise DeployError(f"metadata 'observation_terms_clip' of '{name}' has {len(limits)} numbers")
      found.append(
        Term(
          name=name,
          sources=sources,
          width=width,
          scale=_numbers("observation_terms_scale", scale.split(",")) if scale not in ("", "None") else np.ones(1),
          clip=None if limits is None or not np.isfinite(limits).all() else (float(limits[0]), float(limits[1])),
          history=max(1, int(_numbers("observation_terms_history_length", [history or "0"])[0])),
        )
      )
    return found

  def _meaning(self, name: str) -> tuple[tuple[str, ...], int]:
    count, anchor = len(self.joints), f"imu/{self.anchor}/orientation"
    of_command = (("motion/joint_position", "motion/joint_velocity"), 2 * count)
    known: dict[str, tuple[tuple[str, ...], int]] = {
      "base_lin_vel": (("estimate/linear_velocity",), 3),
      "base_ang_vel": (("imu/gyro",), 3),
      "projected_gravity": (("imu/projected_gravity",), 3),
      "joint_pos": (("joint/position",), count),
      "joint_vel": (("joint/velocity",), count),
      "actions": (("last_action",), count),
      "command": of_command if self.follows_clip else (("command/velocity",), 3),
    }
    if self.follows_clip:
      place = ("motion/anchor_position", f"estimate/{self.anchor}/position", anchor)
      known |= {"motion_anchor_pos_b": (place, 3), "motion_anchor_ori_b": (("motion/anchor_orientation", anchor), 6)}
    known |= {f"{name}_rel": known[name] for name in ("joint_pos", "joint_vel")}
    known |= {"last_action": known["actions"], "velocity_commands": known["command"]}
    check_known("observation of the network", name, known)
    return known[name]

  @property
  def readings(self) -> dict[str, int]:
    """Widths of the readings by name."""
    names = [name for term in self.terms for name in term.sources if name != "last_action"]
    return {
      name: len(self.joints)
      if "joint_" in name or name.startswith("joint/")
      else 4
      if name.endswith("orientation")
      else 3
      for name in names
    }

  @property
  def memories(self) -> dict[str, tuple[int, ...]]:
    """Shapes of the memories by name."""
    found: dict[str, tuple[int, ...]] = {"memory/last_action": (1, len(self.joints)), "memory/time_step": (1, 1)}
    found |= {term.memory: (1, term.history, term.width) for term in self.terms if term.history > 1}
    return found | {f"memory/{name}": tuple(self._inputs[name]) for name in self.states}

  def frame(self, step: int) -> dict[str, np.ndarray]:
    """Return the clip's frame of a step, as the network shows it."""
    zeros = {name: np.zeros(shape, np.float32) for name, shape in self._inputs.items()}
    values = self._session.run(None, zeros | {"time_step": np.full(self._inputs["time_step"], step, np.float32)})
    return {name: np.asarray(value)[0] for name, value in zip(self._outputs, values, strict=True)}

  # The methods of a session

  def get_inputs(self) -> list[Any]:
    shapes = {name: (1, width) for name, width in self.readings.items()} | self.memories
    return [_Value(name, shape) for name, shape in {**shapes, "episode_start": (1, 1)}.items()]

  def get_outputs(self) -> list[Any]:
    width = self._inputs["obs"][-1]
    outputs = {"target/position": (1, len(self.joints)), "action": (1, len(self.joints))}
    outputs[f"observation/{GROUP}"] = (1, width)
    return [_Value(name, shape) for name, shape in outputs.items()] + [
      _Value(f"{name}/next", shape) for name, shape in self.memories.items()
    ]

  def run(self, names: None, feed: Mapping[str, np.ndarray]) -> Sequence[np.ndarray]:
    """Return all outputs."""
    del names
    following: dict[str, np.ndarray] = {}
    parts = [self._observe(term, feed, following) for term in self.terms]
    observation = np.concatenate(parts, axis=1).astype(np.float32)
    given = {"obs": observation} | {name: feed[f"memory/{name}"] for name in self.states}
    if "time_step" in self._inputs:
      given["time_step"] = feed["memory/time_step"]
    values = dict(zip(self._outputs, self._session.run(None, given), strict=True))
    action = np.asarray(values[self._action], np.float32).reshape(1, -1)
    following |= {f"memory/{name}": np.asarray(values[output]) for name, output in self.states.items()}
    following |= {"memory/last_action": action, "memory/time_step": feed["memory/time_step"] + np.float32(1.0)}
    target = (self.default + self.action_scale * action).astype(np.float32)
    return [target, action, observation, *(following[name] for name in self.memories)]

  def _observe(self, term: Term, feed: Mapping[str, np.ndarray], following: dict[str, np.ndarray]) -> np.ndarray:
    sources = [feed[f"memory/{name}" if name == "last_action" else name][0] for name in term.sources]
    frame = self._compute(term.name, sources)
    if term.clip is not None:
      frame = np.clip(frame, *term.clip)
    frame = frame * term.scale
    if term.history == 1:
      return frame[None]
    past = np.concatenate((feed[term.memory][0, 1:], frame[None]))
    if feed["episode_start"][0, 0]:
      past = np.repeat(frame[None], term.history, axis=0)
    following[term.memory] = past[None].astype(np.float32)
    return past.reshape(1, -1)

  def _compute(self, name: str, sources: list[np.ndarray]) -> np.ndarray:
    if name.startswith("joint_pos"):
      return sources[0] - self.default
    if name == "motion_anchor_pos_b":
      return (sources[0] - sources[1]) @ _matrix(sources[2])
    if name == "motion_anchor_ori_b":
      return (_matrix(sources[1]).T @ _matrix(sources[0])).ravel()[list(_SIX)]
    return np.concatenate(sources)


@dataclass(frozen=True)
class _Value:
  name: str
  shape: tuple[int, ...]


def _numbers(key: str, words: Sequence[str]) -> np.ndarray:
  try:
    values = np.array([float(word) for word in words])
    if np.isnan(values).any():
      raise ValueError
  except ValueError as error:
    raise DeployError(f"metadata '{key}' has a value that is not a number: {', '.join(words)[:80]}") from error
  return values


def _matrix(quat: np.ndarray) -> np.ndarray:
  """Return the rotation matrix of a quaternion (w, x, y, z)."""
  matrix = np.empty(9)
  mujoco.mju_quat2Mat(matrix, quat / max(float(np.linalg.norm(quat)), 1e-9))
  return matrix.reshape(3, 3)
