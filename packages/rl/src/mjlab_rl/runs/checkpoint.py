"""Checkpoint files: complete on disk or absent, and read without running code."""

import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import msgspec
import torch
from mjlab_core import printable
from mjlab_core.errors import FileError, MjlabError
from mjlab_core.io.files import AtomicWrite, reading
from msgspec import Meta, Struct
from torch import Tensor

FORMAT = 1
_MAX_BYTES = 8 * 2**30

Shapes: TypeAlias = Sequence[Sequence[int]]
"""Shapes of the observation groups that a network sees, for one world."""
_Count = Annotated[int, Meta(ge=0)]
_Tensors = dict[str, torch.Tensor]
_Weights = Annotated[_Tensors, Meta(min_length=1)]


class _Generators(Struct):
  torch: Tensor
  numpy: tuple[str, Tensor, int, int, float]
  python: tuple[int, tuple[int, ...], float | None]
  cuda: Tensor | None = None


class _Rank(Struct, kw_only=True):
  """State of one process: its worlds and random generators."""

  env: dict[str, Any]
  statistics: _Tensors
  hidden_states: list[Any]
  rng: _Generators


class _Worlds(_Rank, kw_only=True):
  """State of the first process, state common to all, and the state of the others."""

  format: Literal[1]
  num_envs: _Count
  elapsed: Annotated[float, Meta(ge=0)]
  total_steps: _Count
  shapes_seen: dict[str, list[list[_Count]]] = {}
  other_ranks: list[_Rank] = []


class _Optimizer(Struct):
  state: dict[int, dict[str, Any]]
  param_groups: Annotated[list[dict[str, Any]], Meta(min_length=1)]


class _EnvState(Struct):
  common_step_counter: _Count | None = None


class _Infos(Struct):
  env_state: _EnvState | None = None


class _Checkpoint(Struct):
  """Schema of a checkpoint of ours, or of one of rsl-rl, which has no `mjlab`. Other keys are allowed."""

  iter: _Count
  infos: _Infos | None = None
  mjlab: _Worlds | None = None
  actor_state_dict: _Weights | None = None
  critic_state_dict: _Weights | None = None
  student_state_dict: _Weights | None = None
  teacher_state_dict: _Weights | None = None
  optimizer_state_dict: _Optimizer | None = None


def write_checkpoint(path: Path, state: dict[str, Any]) -> None:
  """Write `state` to `path`, completely or not at all.

  Raises:
    FileError: It cannot be written, for lack of room for instance.
  """
  try:
    with AtomicWrite(path) as temporary:
      torch.save(state, temporary)
  except (OSError, RuntimeError) as error:
    # Torch reports a full disk as a RuntimeError about positions in the archive.
    raise FileError(f"checkpoint {path} could not be written: {printable(error, 200)}; is there room?") from error


def read_checkpoint(path: Path, *policies: str) -> dict[str, Any]:
  """Read a checkpoint onto the host; only tensors and plain values are accepted.

  Args:
    path: The file.
    *policies: Names of networks of which it must have one; none: "actor".

  Raises:
    FileError: There is no such file, or it is not a checkpoint that this version reads.
  """
  with reading("checkpoint", path, _MAX_BYTES):
    _check_archive(path)
    try:
      state: Any = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
      if "weights_only" in str(error) or "Unsupported" in str(error):
        raise FileError("holds objects other than tensors and plain values, not loaded") from error
      raise FileError(f"damaged or not a checkpoint ({printable(error, 200)})") from error
    wanted = [f"{name}_state_dict" for name in policies or ("actor",)]
    if not isinstance(state, dict) or not any(name in state for name in wanted):
      found = sorted(map(str, state)) if isinstance(state, dict) else type(state).__name__
      raise FileError(f"no {' or '.join(map(repr, wanted))} in it; found {printable(found, 200)}")
    ours = state.get("mjlab")
    if isinstance(ours, dict) and ours.get("format") != FORMAT:
      raise FileError(f"written by another version of mjlab-rl; this one reads format {FORMAT}")
    msgspec.convert(state, _Checkpoint, dec_hook=as_tensor)
    return state


def _check_archive(path: Path) -> None:
  """Refuse files of another kind, and records that would unpack to more than the file holds."""
  # torch would tell the user to switch off `weights_only`, which keeps a file from running code.
  if not zipfile.is_zipfile(path):
    raise FileError("damaged or not a checkpoint")
  with zipfile.ZipFile(path) as archive:
    if any(record.compress_type != zipfile.ZIP_STORED for record in archive.infolist()):
      raise FileError("holds compressed records, which torch does not write")


def as_tensor(kind: type, value: Any) -> Any:
  """Return a dense tensor as it is; the `dec_hook` of schemas."""
  if kind is not torch.Tensor or not isinstance(value, torch.Tensor) or value.layout != torch.strided:
    raise TypeError(f"expected a dense {kind.__name__.lower()}, got {type(value).__name__}")
  return value


def shapes_seen(state: Mapping[str, Any], network: str) -> Shapes | None:
  """Return the shapes of one world's observation groups that a network saw; None where the file does not say."""
  return (state.get("mjlab") or {}).get("shapes_seen", {}).get(network)


def refuse(what: str, problems: Iterable[str], hint: str = "", error: type[MjlabError] = FileError) -> None:
  """Raise `error` if there are problems.

  Raises:
    MjlabError: There are problems; the message names the first four.
  """
  if found := list(problems):
    more = f"; and {len(found) - 4} more" if len(found) > 4 else ""
    raise error(f"{what} does not fit: {'; '.join(found[:4])}{more}{hint}")


def check_finite(path: Path, part: str, saved: Mapping[str, Any]) -> None:
  """Refuse a network with weights that are NaN or infinite.

  Raises:
    FileError: Some are; the message names the first.
  """
  broken = [name for name, value in saved.items() if value.is_floating_point() and not bool(value.isfinite().all())]
  if broken:
    raise FileError(f"checkpoint {path}: the file has NaN or infinite weights in {part}: {', '.join(broken[:4])}")


def shape_problems(groups: Sequence[str], trained: Shapes | None, present: Shapes) -> Iterator[str]:
  """Yield a line for each observation group that had another shape in training; weights may fit images of any size.

  Args:
    groups: Names of the groups.
    trained: Their shapes in training; None: not known.
    present: Their current shapes.
  """
  for group, was, now in zip(groups, trained or (), present, strict=False):
    if list(was) != list(now):
      was, now = (" x ".join(map(str, shape)) for shape in (was, now))
      yield f"observation group '{group}' was {was} in its training and is {now} here"


def network_problems(part: str, saved: Mapping[str, Any], present: Mapping[str, Any]) -> Iterator[str]:
  """Yield a line for each weight with another name, shape or kind of number than in the network."""
  for name in dict.fromkeys((*present, *saved)):
    theirs, ours = saved.get(name), present.get(name)
    if theirs is None or ours is None:
      yield f"{part}: {printable(name, 80)} is {'missing' if theirs is None else 'only'} in the file"
    elif _shape(theirs) != _shape(ours):
      yield f"{part}: {name} is {_shape(theirs)} in the file and {_shape(ours)} here"
    elif theirs.is_complex() or theirs.is_floating_point() != ours.is_floating_point():
      yield f"{part}: {name} is {theirs.dtype}, not {ours.dtype}"


def optimizer_problems(saved: Mapping[str, Any], present: torch.optim.Optimizer) -> Iterator[str]:
  """Yield a line for each part of a saved optimiser that differs in kind or size; kinds share names of settings."""
  theirs, ours = saved["param_groups"], present.state_dict()["param_groups"]
  kinds = [(set(groups[0]), groups[0].get("decoupled_weight_decay")) for groups in (theirs, ours)]
  if kinds[0] != kinds[1]:
    yield "agent.algorithm.optimizer was another one in its training"
  elif [group["params"] for group in theirs] != [group["params"] for group in ours]:
    yield "its optimiser has other parameters"
  else:
    shapes = [_shape(parameter) for group in present.param_groups for parameter in group["params"]]
    for number, state in saved["state"].items():
      shape = shapes[number] if number < len(shapes) else None
      for name, value in state.items():
        if not isinstance(value, torch.Tensor) or not value.is_floating_point() or _shape(value) not in ((), shape):
          yield f"optimiser: {printable(name, 60)} of parameter {number}"
    for name, value in theirs[0].items():
      if name != "params" and type(value) is not type(ours[0][name]):
        yield f"optimiser: {printable(name, 60)} is a {type(value).__name__}"


def _shape(value: Any) -> tuple[int, ...]:
  return tuple(getattr(value, "shape", ()))
