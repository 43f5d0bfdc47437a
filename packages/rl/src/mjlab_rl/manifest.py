"""The run manifest: a JSON file from which a run's configuration is rebuilt, equal to the last bit.

Data is written as data. Classes and functions are written as names ("module:name") and imported again on reading, so a
manifest holds no code; what cannot be imported by name (a lambda, a function inside a function) is refused when the run
starts, with the field it is in.
"""

import dataclasses
import enum
import functools
import importlib
import json
import math
import os
import platform
import subprocess
import sys
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from types import BuiltinFunctionType, FunctionType, MethodType, ModuleType
from typing import Any, TypeAlias

from mjlab_rl.config import RslRlBaseRunnerCfg

MANIFEST_NAME = "manifest.json"
_FORMAT = 1
# What physics and learning are made of. Members of mjlab and packages that offer tasks are found by themselves.
_STACK = ("mujoco", "mujoco-warp", "warp-lang", "torch", "tensordict", "rsl-rl-lib", "numpy")

# JSON data: None, booleans, numbers, strings, lists and dictionaries of them.
Json: TypeAlias = Any


class ManifestError(ValueError):
  """A configuration that cannot be written down, or a manifest that cannot be read; the message names the field."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class PolicyRecord:
  """A trained policy that another learned from, or began as."""

  checkpoint: str
  """Checkpoint file, absolute."""
  sha256: str
  """Hash of the file."""
  task: str | None
  """Task it was trained for; None: it does not say."""
  iterations: int
  """Iterations it was trained for."""


@dataclasses.dataclass(kw_only=True)
class RunManifest:
  """What a run was started with."""

  task: str
  """Task id."""
  env: Any
  """Environment configuration, overrides included."""
  agent: RslRlBaseRunnerCfg
  """Learner configuration, overrides included."""
  runner: type[Any] | None = None
  """Runner class of the task; None: the standard one for such a learner."""
  make_env: Callable[..., Any] | None = None
  """Environment factory of the task; None: the standard environment class."""
  play: Callable[..., Any] | None = None
  """Turns `env` into the configuration for watching; None: as it is."""
  seed: int = 0
  """Seed of learner and environment."""
  device: str = ""
  """Device trained on."""
  created: str = ""
  """Local time of the start, ISO 8601 with offset."""
  command: list[str] = dataclasses.field(default_factory=list)
  """Command line."""
  resumed_from: str | None = None
  """Checkpoint that the run continued."""
  teacher: PolicyRecord | None = None
  """Whom the policy learned from, in a distillation."""
  init_from: PolicyRecord | None = None
  """Whose policy this one was in the beginning; None: its weights were drawn."""
  versions: dict[str, str] = dataclasses.field(default_factory=dict)
  """Versions of Python, the operating system and the packages that matter."""
  git: dict[str, Any] | None = None
  """Commit of the repository that the task's own code is in, and whether it had changes; None where that is unknown."""


def encode(value: object, where: str = "config") -> Json:
  """JSON data from which `decode` rebuilds `value`.

  Handles dataclasses (their init fields), named tuples, functions and classes with an importable name, partials, enums,
  tuples, lists, sets, dictionaries with any keys, slices, ranges, paths, NumPy arrays and scalars, infinities and NaN.

  Raises:
    ManifestError: Something in it cannot be rebuilt; the message names the field, starting with `where`.
  """
  if value is None or type(value) in (bool, int, str):
    return value
  if type(value) is float:
    return value if math.isfinite(value) else {"$float": repr(value)}
  if type(value) is list:
    return [encode(item, f"{where}[{i}]") for i, item in enumerate(value)]
  if type(value) is tuple:
    return {"$tuple": [encode(item, f"{where}[{i}]") for i, item in enumerate(value)]}
  if isinstance(value, (set, frozenset)):
    items = sorted((encode(item, where) for item in value), key=json.dumps)
    return {"$set" if isinstance(value, set) else "$frozenset": items}
  if type(value) is dict:
    if all(type(key) is str and not key.startswith("$") for key in value):
      return {key: encode(item, f"{where}.{key}") for key, item in value.items()}
    return {"$dict": [[encode(key, where), encode(item, f"{where}[{key!r}]")] for key, item in value.items()]}
  if isinstance(value, (type, FunctionType, BuiltinFunctionType, MethodType)):
    return {"$ref": _reference(value, where)}
  if isinstance(value, enum.Enum):
    return {"$enum": _reference(type(value), where), "name": value.name}
  if dataclasses.is_dataclass(value):
    names = [field.name for field in dataclasses.fields(value) if field.init]
    return {
      "$type": _reference(type(value), where),
      "fields": {name: encode(getattr(value, name), f"{where}.{name}") for name in names},
    }
  if isinstance(value, tuple) and hasattr(value, "_fields"):
    named: dict[str, Any] = value._asdict()  # pyright: ignore[reportAttributeAccessIssue]  # ty: ignore[missing-attribute]
    return {
      "$type": _reference(type(value), where),
      "fields": {name: encode(item, f"{where}.{name}") for name, item in named.items()},
    }
  if isinstance(value, functools.partial):
    return {
      "$partial": encode(value.func, where),
      "args": [encode(item, f"{where}.args[{i}]") for i, item in enumerate(value.args)],
      "keywords": {key: encode(item, f"{where}.{key}") for key, item in value.keywords.items()},
    }
  if isinstance(value, (slice, range)):
    return {f"${type(value).__name__}": [encode(item, where) for item in (value.start, value.stop, value.step)]}
  if isinstance(value, Path):
    return {"$path": str(value)}
  return _encode_foreign(value, where)


def _encode_foreign(value: object, where: str) -> Json:
  """NumPy values and the enums of compiled modules (MuJoCo's), recognised without importing either."""
  kind = type(value)
  if kind.__module__ == "numpy":
    array: Any = value
    tag = "$array" if kind.__name__ == "ndarray" else "$scalar"
    return {tag: encode(array.tolist(), where), "dtype": str(array.dtype), "shape": list(array.shape)}
  name = getattr(value, "name", None)
  if isinstance(name, str) and getattr(kind, name, None) == value:
    return {"$enum": _reference(kind, where), "name": name}
  if callable(value):
    return {"$ref": _reference(value, where)}
  raise ManifestError(
    f"{where}: a {kind.__module__}.{kind.__qualname__} cannot be written to the run manifest. "
    "Use plain values, dataclasses, or a function of a module that builds it."
  )


def decode(data: Json, where: str = "config") -> Any:
  """Rebuild what `encode` wrote. Imports modules by name and calls dataclass constructors; runs nothing else.

  Raises:
    ManifestError: A name no longer exists, or a class no longer has a field; the message says where.
  """
  if isinstance(data, list):
    return [decode(item, f"{where}[{i}]") for i, item in enumerate(data)]
  if not isinstance(data, dict):
    return data
  tag = next((key for key in data if key.startswith("$")), None)
  if tag is None:
    return {key: decode(item, f"{where}.{key}") for key, item in data.items()}
  body: Any = data[tag]
  match tag:
    case "$float":
      return float(body)
    case "$tuple":
      return tuple(decode(item, f"{where}[{i}]") for i, item in enumerate(body))
    case "$set":
      return {decode(item, where) for item in body}
    case "$frozenset":
      return frozenset(decode(item, where) for item in body)
    case "$dict":
      return {decode(key, where): decode(item, f"{where}[{key!r}]") for key, item in body}
    case "$slice":
      return slice(*(decode(item, where) for item in body))
    case "$range":
      return range(*body)
    case "$path":
      return Path(body)
    case "$ref":
      return _resolve(body, where)
    case "$enum":
      return _resolve(f"{body}.{data['name']}", where)
    case "$partial":
      args: Any = data["args"]
      keywords: Any = data["keywords"]
      return functools.partial(decode(body, where), *decode(args, where), **decode(keywords, where))
    case "$type":
      return _construct(_resolve(body, where), data["fields"], where)
    case "$array" | "$scalar":
      import numpy as np

      array = np.array(decode(body, where), dtype=data["dtype"]).reshape(data["shape"])
      return array if tag == "$array" else array[()]
    case _:
      raise ManifestError(f"{where}: unknown tag '{tag}'; was the manifest written by a newer version?")


def _construct(kind: Any, fields: Any, where: str) -> Any:
  known = getattr(kind, "__dataclass_fields__", None) or getattr(kind, "_fields", None)
  if not isinstance(kind, type) or known is None:
    raise ManifestError(f"{where}: {kind!r} is not a dataclass")
  values = {name: decode(item, f"{where}.{name}") for name, item in fields.items()}
  for name in values:
    if name not in known:
      raise ManifestError(f"{where}: {kind.__qualname__} has no field '{name}' any more; it has {', '.join(known)}")
  try:
    return kind(**values)
  except (TypeError, ValueError) as error:
    # A field that came later, or a value that is refused now.
    raise ManifestError(f"{where}: {kind.__qualname__} cannot be made from what the manifest says: {error}") from error


def _reference(value: Any, where: str) -> str:
  module: str = getattr(value, "__module__", None) or ""
  name: str = getattr(value, "__qualname__", None) or getattr(value, "__name__", "")
  shown = f"{module}:{name}" if name else repr(value)
  if "<lambda>" in name or "<locals>" in name or not name:
    kind = "a lambda" if "<lambda>" in name else f"'{shown}', defined inside a function,"
    raise ManifestError(f"{where}: {kind} has no importable name. Use a function of a module; bind values with params.")
  if module == "__main__":
    spec = getattr(sys.modules["__main__"], "__spec__", None)
    if spec is None:
      raise ManifestError(f"{where}: '{name}' is defined in a script; move it into a module that can be imported.")
    module = spec.name
  if _lookup(sys.modules.get(module), name) != value:
    raise ManifestError(f"{where}: '{shown}' is not what importing that name gives.")
  return f"{module}:{name}"


def _resolve(reference: Any, where: str) -> Any:
  module_name, _, name = str(reference).partition(":")
  try:
    module = importlib.import_module(module_name)
  except ImportError as error:
    raise ManifestError(f"{where}: module '{module_name}' cannot be imported ({error})") from error
  found = _lookup(module, name)
  if found is None:
    raise ManifestError(f"{where}: module '{module_name}' has no '{name}'")
  return found


def _lookup(module: ModuleType | None, name: str) -> Any:
  found: Any = module
  for part in name.split("."):
    found = getattr(found, part, None)
  return found


def encode_manifest(manifest: RunManifest) -> dict[str, Json]:
  """The manifest as JSON data.

  Raises:
    ManifestError: A configuration holds something that cannot be written down.
  """
  data: dict[str, Json] = {"format": _FORMAT}
  for field in dataclasses.fields(manifest):
    data[field.name] = encode(getattr(manifest, field.name), field.name)
  return data


def write_manifest(directory: Path, manifest: RunManifest) -> Path:
  """Write `manifest.json` into a run directory; returns its path."""
  path = directory / MANIFEST_NAME
  temporary = path.with_suffix(".json.tmp")
  temporary.write_text(json.dumps(encode_manifest(manifest), indent=1, allow_nan=False) + "\n", encoding="utf-8")
  os.replace(temporary, path)
  return path


def load_run(path: str | os.PathLike[str]) -> RunManifest:
  """Configuration of a run, rebuilt from its directory, a checkpoint in it, or the manifest itself.

  Raises:
    FileNotFoundError: There is no manifest.
    ManifestError: It cannot be rebuilt; the message names the field.
  """
  path = Path(path)
  if path.name != MANIFEST_NAME:
    path = (path if path.is_dir() else path.parent) / MANIFEST_NAME
  if not path.is_file():
    raise FileNotFoundError(f"{path}: no such file; is {path.parent} a run directory?")
  try:
    data = json.loads(path.read_text(encoding="utf-8"))
  except ValueError as error:
    raise ManifestError(f"{path}: not JSON ({error})") from error
  if not isinstance(data, dict) or data.pop("format", None) != _FORMAT:
    raise ManifestError(f"{path}: written by another version of mjlab-rl; this one reads format {_FORMAT}")
  try:
    return _construct(RunManifest, data, "manifest")
  except ManifestError as error:
    raise ManifestError(f"{path}: {error}") from error


def task_of(directory: Path) -> str | None:
  """Task id of a run; None where its manifest is not there or cannot be read."""
  try:
    data = json.loads((directory / MANIFEST_NAME).read_text(encoding="utf-8"))
  except (OSError, ValueError):
    return None
  return data.get("task") if isinstance(data, dict) else None


def package_versions() -> dict[str, str]:
  """Versions of Python, the operating system and the installed packages that decide how a run goes.

  These are all members of mjlab, the packages that offer tasks, and the physics and learning libraries.
  """
  versions = {"python": platform.python_version(), "platform": platform.platform()}
  installed = {item.name for item in metadata.distributions() if item.name}
  offer_tasks = {point.dist.name for point in metadata.entry_points(group="mjlab.tasks") if point.dist}
  members = {name for name in installed if name == "mjlab" or name.startswith("mjlab-")} | offer_tasks
  return versions | {name: metadata.version(name) for name in (*sorted(members), *_STACK) if name in installed}


def git_state(file: Path) -> dict[str, Any] | None:
  """Commit of the repository that tracks `file`, and whether it has changes; None where none does.

  An installed file is tracked by none, also where its environment lies in a repository.
  """
  try:
    file = file.resolve()
    _git(file.parent, "ls-files", "--error-unmatch", file.name)
    commit = _git(file.parent, "rev-parse", "HEAD")
    return {"commit": commit, "dirty": bool(_git(file.parent, "status", "--porcelain", "--untracked-files=no"))}
  except (OSError, subprocess.SubprocessError):
    return None


def _git(directory: Path, *arguments: str) -> str:
  done = subprocess.run(["git", *arguments], cwd=directory, capture_output=True, text=True, check=True, timeout=10)
  return done.stdout.strip()
