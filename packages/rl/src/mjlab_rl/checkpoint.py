"""Checkpoint files: written whole or not at all, read without running code."""

import os
import pickle
import random
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import torch

FORMAT = 1

Shapes: TypeAlias = Sequence[Sequence[int]]
"""Of each observation group that a network sees, the shape for one world."""


class CheckpointError(ValueError):
  """A checkpoint that cannot be read or does not fit; the message says why."""


def write_checkpoint(path: Path, state: dict[str, Any]) -> None:
  """Write `state` to `path`: under another name first, so that no crash leaves half a file under this one.

  Raises:
    CheckpointError: It cannot be written, for lack of room for instance.
  """
  temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
  try:
    torch.save(state, temporary)
    os.replace(temporary, path)
  except (OSError, RuntimeError) as error:
    # Torch tells of a full disk in riddles.
    raise CheckpointError(
      f"checkpoint {path} could not be written ({_first_line(error)}); is there room on the disk?"
    ) from error
  finally:
    temporary.unlink(missing_ok=True)


def read_checkpoint(path: Path, *policies: str) -> dict[str, Any]:
  """Read a checkpoint onto the host; only tensors and plain values are accepted.

  Args:
    path: The file.
    *policies: Names of networks of which it must have one; none: "actor".

  Raises:
    CheckpointError: There is no such file, it is not a checkpoint, or one of another version.
  """
  if not path.is_file():
    raise CheckpointError(f"checkpoint {path}: no such file")
  try:
    state = torch.load(path, map_location="cpu", weights_only=True)
  except pickle.UnpicklingError as error:
    raise CheckpointError(
      f"checkpoint {path}: holds objects other than tensors and plain values, not loaded"
    ) from error
  except (OSError, RuntimeError, EOFError, ValueError, LookupError, AttributeError, TypeError) as error:
    raise CheckpointError(f"checkpoint {path}: damaged or not a checkpoint ({_first_line(error)})") from error
  wanted = [f"{name}_state_dict" for name in policies or ("actor",)]
  if not isinstance(state, dict) or not any(name in state for name in wanted):
    found = sorted(map(str, state)) if isinstance(state, dict) else type(state).__name__
    raise CheckpointError(f"checkpoint {path}: no {' or '.join(map(repr, wanted))} in it; found {found}")
  ours = state.get("mjlab", {"format": FORMAT})
  if not isinstance(ours, dict) or ours.get("format") != FORMAT:
    raise CheckpointError(f"checkpoint {path}: written by another version of mjlab-rl; this one reads format {FORMAT}")
  return state


def read_policy(path: Path, policy: str) -> tuple[dict[str, Any], Shapes | None]:
  """The weights of the policy in a checkpoint, of a run by reinforcement, "actor", or of a distillation, "student".

  Args:
    path: The file.
    policy: Which of the two it is where there are both.

  Returns:
    The weights, and what `shapes_seen` says.

  Raises:
    CheckpointError: As `read_checkpoint`.
  """
  names = dict.fromkeys((policy, "actor", "student"))
  state = read_checkpoint(path, *names)
  name = next(name for name in names if f"{name}_state_dict" in state)
  return state[f"{name}_state_dict"], shapes_seen(state, name)


def shapes_seen(state: Mapping[str, Any], network: str) -> Shapes | None:
  """Shapes of one world's observation groups as a network of a checkpoint saw them; None where it does not say."""
  return state.get("mjlab", {}).get("shapes_seen", {}).get(network)


def check_shapes_seen(path: Path, groups: Sequence[str], trained: Shapes | None, present: Shapes) -> None:
  """Compare what a network saw in its training with what it is to see; an image of another size may fit all weights.

  Args:
    path: File that it is from.
    groups: Names of the observation groups that it is to see.
    trained: Their shapes in its training; None: not known.
    present: Their shapes now.

  Raises:
    CheckpointError: They differ; the message says in what.
  """
  differences = [
    f"observation group '{group}' was {_by(was)} in its training and is {_by(now)} here"
    for group, was, now in zip(groups, trained or (), present, strict=False)
    if list(was) != list(now)
  ]
  if differences:
    raise CheckpointError(f"policy {path} does not fit: {'; '.join(differences)}")


def check_fit(path: Path, part: str, saved: Mapping[str, Any], present: Mapping[str, Any]) -> None:
  """Compare a saved network with the one it is to fill.

  Raises:
    CheckpointError: Names or shapes differ; the message lists how.
  """
  differences = [
    f"{name} is {_shape(saved[name])} in the file and {_shape(present[name])} here"
    for name in present
    if name in saved and _shape(saved[name]) != _shape(present[name])
  ]
  differences += [f"{name} is missing in the file" for name in present if name not in saved]
  differences += [f"{name} is only in the file" for name in saved if name not in present]
  if differences:
    shown = "; ".join(differences[:4]) + (f"; and {len(differences) - 4} more" if len(differences) > 4 else "")
    raise CheckpointError(
      f"checkpoint {path} does not fit: {part}: {shown}. Observations, actions, agent.{part}.hidden_dims and "
      f"agent.{part}.obs_normalization must be those it was trained with."
    )


def check_optimizer(path: Path, saved: Mapping[str, Any], present: Mapping[str, Any]) -> None:
  """Compare the state of a saved optimiser with that of the one it is to fill.

  Raises:
    CheckpointError: They are of different kinds: each would take the other's settings for its own.
  """
  kinds = [
    (set(group), group.get("decoupled_weight_decay"))
    for group in (saved["param_groups"][0], present["param_groups"][0])
  ]
  if kinds[0] != kinds[1]:
    raise CheckpointError(f"checkpoint {path} does not fit: agent.algorithm.optimizer was another one in its training")


def rng_state(device: torch.device) -> dict[str, Any]:
  """State of every generator of the process: torch on the host and on `device`, NumPy's and Python's global ones."""
  name, keys, position, has_gauss, cached = np.random.get_state(legacy=True)  # noqa: NPY002
  state: dict[str, Any] = {
    "torch": torch.get_rng_state(),
    "numpy": (name, torch.from_numpy(np.asarray(keys, dtype=np.int64)), int(position), int(has_gauss), float(cached)),
    "python": random.getstate(),
  }
  if device.type == "cuda":
    state["cuda"] = torch.cuda.get_rng_state(device)
  return state


def restore_rng_state(state: dict[str, Any], device: torch.device) -> None:
  """Put every generator back; on a device of another kind its own generator stays as it is."""
  torch.set_rng_state(state["torch"])
  name, keys, position, has_gauss, cached = state["numpy"]
  np.random.set_state((name, keys.numpy().astype(np.uint32), position, has_gauss, cached))  # noqa: NPY002
  version, internal, gauss = state["python"]
  random.setstate((version, tuple(internal), gauss))
  if device.type == "cuda" and "cuda" in state:
    torch.cuda.set_rng_state(state["cuda"], device)


def _by(shape: Sequence[int]) -> str:
  return " x ".join(map(str, shape))


def _shape(value: Any) -> tuple[int, ...]:
  return tuple(getattr(value, "shape", ()))


def _first_line(error: BaseException) -> str:
  return (str(error).splitlines() or [type(error).__name__])[0]
