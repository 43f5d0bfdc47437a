"""Run manifest: a JSON file from which a run's configuration is rebuilt, equal to the last bit.

Configurations are data; functions and classes are names ("module:name") of trusted packages. Reading a manifest
resolves names and calls none of them. The README lists the files that are safe to load from untrusted sources.
"""

import dataclasses
import functools
import inspect
import json
import os
import platform
import subprocess
from collections.abc import Callable, Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import msgspec
from mjlab_core import printable, unknown
from mjlab_core.errors import ConfigError, FileError
from mjlab_core.io.files import AtomicWrite, reading

from mjlab_rl.config import RslRlBaseRunnerCfg
from mjlab_rl.runs.encoding import Json, construct, encode
from mjlab_rl.runs.field_types import callable_problems
from mjlab_rl.runs.references import distribution_name, offered, resolve

MANIFEST_NAME = "manifest.json"
_FORMAT = 1
# Libraries of physics and learning; members of mjlab and task packages are found automatically.
_STACK = ("mujoco", "mujoco-warp", "warp-lang", "torch", "tensordict", "rsl-rl-lib", "numpy")

_MAX_BYTES = 16 * 2**20
# Classes that rsl-rl knows without a module.
_LEARNER_CLASSES = (
  "MLPModel", "RNNModel", "CNNModel", "PPO", "Distillation", "GaussianDistribution",
  "HeteroscedasticGaussianDistribution", "BetaDistribution",
)  # fmt: skip


@dataclasses.dataclass(frozen=True, kw_only=True)
class PolicyRecord:
  """Trained policy that a run learned or started from."""

  checkpoint: str
  """Checkpoint file, absolute."""
  sha256: str
  """Hash of the file."""
  task: str | None
  """Task of its training; None: not known."""
  iterations: int
  """Iterations of its training."""


@dataclasses.dataclass(kw_only=True)
class RunManifest:
  """Configuration and origin of a run."""

  task: str
  """Task id."""
  env: Any
  """Environment configuration, overrides included."""
  agent: RslRlBaseRunnerCfg
  """Learner configuration, overrides included."""
  runner: type[Any] | None = None
  """Runner class of the task; None: the standard one of the learner."""
  make_env: Callable[..., Any] | None = None
  """Environment factory of the task; None: the standard environment class."""
  play: Callable[..., Any] | None = None
  """Function from `env` to the configuration for watching; None: no change."""
  seed: int = 0
  """Seed of learner and environment."""
  device: str = ""
  """Device trained on."""
  created: str = ""
  """Local time of the start, ISO 8601 with offset."""
  command: list[str] = dataclasses.field(default_factory=list)
  """Command line."""
  launch: str = ""
  """Id that the launcher gave to all processes, also after a restart; empty without one."""
  resumed_from: str | None = None
  """Checkpoint that the run continued."""
  teacher: PolicyRecord | None = None
  """Teacher of a distillation."""
  more_teachers: list[PolicyRecord] = dataclasses.field(default_factory=list)
  """Teachers of a distillation after the first."""
  init_from: PolicyRecord | None = None
  """Policy that the run started from; None: random weights."""
  versions: dict[str, str] = dataclasses.field(default_factory=dict)
  """Versions of Python, the operating system and the packages that matter."""
  git: dict[str, Any] | None = None
  """Commit and uncommitted changes of the repository of the task's code; None: not known."""


def encode_manifest(manifest: RunManifest) -> dict[str, Json]:
  """Return the manifest as JSON data, from which it can be rebuilt.

  Raises:
    ConfigError: A configuration holds something that cannot be written down or would be refused when it is read.
  """
  data = {field.name: encode(getattr(manifest, field.name), field.name) for field in dataclasses.fields(manifest)}
  try:
    _manifest(json.loads(json.dumps(data)))
  except FileError as error:
    raise ConfigError(str(error)) from error
  return {"format": _FORMAT, **data}


def write_manifest(directory: Path, manifest: RunManifest) -> Path:
  """Write `manifest.json` into a run directory; return its path."""
  path = directory / MANIFEST_NAME
  text = json.dumps(encode_manifest(manifest), indent=1, allow_nan=False) + "\n"
  with AtomicWrite(path) as temporary:
    temporary.write_text(text, encoding="utf-8")
  return path


def load_run(path: str | os.PathLike[str]) -> RunManifest:
  """Rebuild the configuration of a run from its directory, a checkpoint in it, or the manifest itself.

  Raises:
    FileNotFoundError: There is no manifest.
    FileError: It cannot be rebuilt; the message names the file and the field.
  """
  path = Path(path)
  if path.name != MANIFEST_NAME:
    path = (path if path.is_dir() else path.parent) / MANIFEST_NAME
  if not path.is_file():
    raise FileNotFoundError(f"{path}: no such file; is {path.parent} a run directory?")
  with reading("manifest", path, _MAX_BYTES):
    data = msgspec.json.decode(path.read_bytes())
    if not isinstance(data, dict) or data.pop("format", None) != _FORMAT:
      raise FileError(f"not a manifest of format {_FORMAT}, which this version of mjlab-rl reads")
    return _manifest(data)


def _manifest(data: dict[str, Json]) -> RunManifest:
  """Rebuild a manifest and check that every function in it fits its place."""
  manifest: RunManifest = construct(RunManifest, data, "")
  for problem in _problems(manifest):
    raise FileError(problem)
  return manifest


def _problems(manifest: RunManifest) -> Iterator[str]:
  kind = type(manifest.env)
  if not dataclasses.is_dataclass(kind):
    yield f"env: expected a dataclass, got {kind.__name__}"
  if manifest.play is not None:
    yield from callable_problems(manifest.play, ([kind], kind), "play")
  if manifest.make_env is not None and not {"device"} <= inspect.signature(manifest.make_env).parameters.keys():
    yield "make_env: it is called as make_env(cfg, device=device), but takes no 'device'"
  if manifest.runner is not None:
    from mjlab_rl.runner import MjlabOnPolicyRunner

    if not issubclass(manifest.runner, MjlabOnPolicyRunner):
      yield f"runner: {manifest.runner.__qualname__} is not a subclass of MjlabOnPolicyRunner"
  yield from _learner_problems(vars(manifest.agent), "agent")


def _learner_problems(values: Mapping[str, Any], where: str) -> Iterator[str]:
  """Check the names that rsl-rl would import and call: classes, and the function of its symmetry."""
  for name, value in values.items():
    field = f"{where}.{name}"
    if isinstance(value, Mapping):
      yield from _learner_problems(value, field)
    elif dataclasses.is_dataclass(value):
      yield from _learner_problems(vars(value), field)
    elif name in ("class_name", "data_augmentation_func") and value is not None and value not in _LEARNER_CLASSES:
      if isinstance(value, str) and ":" not in value and "." not in value:
        yield f"{field}: {unknown('class of rsl-rl', value, _LEARNER_CLASSES)} Or write 'module:name'."
        continue
      found = resolve(value, field, frozenset({"rsl_rl"})) if isinstance(value, str) else value
      if name == "class_name" and not _is_learner_class(found):
        yield f"{field}: {printable(value, 120)!r} is not a network, distribution or algorithm"
      elif name != "class_name" and "env" not in inspect.signature(found).parameters:
        yield f"{field}: {printable(value, 120)!r} does not take 'env'"


def _is_learner_class(found: Any) -> bool:
  """Return True for subclasses of torch's modules, rsl-rl's classes and our algorithms, without importing any."""
  return isinstance(found, type) and any(
    base.__module__.partition(".")[0] in ("torch", "rsl_rl") or base.__module__ == "mjlab_rl.offpolicy.algorithm"
    for base in found.__mro__
  )


def manifest_entry(directory: Path, name: str) -> str | None:
  """Return a text of a run's manifest, such as its task; None if the manifest is missing or cannot be read."""
  try:
    with reading("manifest", directory / MANIFEST_NAME, _MAX_BYTES) as path:
      value = msgspec.json.decode(path.read_bytes(), type=dict[str, Any]).get(name)
  except FileError:
    return None
  return value if isinstance(value, str) else None


@functools.cache
def package_versions() -> dict[str, str]:
  """Return the versions of Python, the operating system, mjlab's members, other tasks and robots, and libraries."""
  versions = {"python": platform.python_version(), "platform": platform.platform()}
  installed = {distribution_name(item) for item in metadata.distributions()}
  others = {distribution_name(point.dist) for point in offered() if point.dist}
  members = {name for name in installed if name == "mjlab" or name.startswith("mjlab-")} | others
  return versions | {name: metadata.version(name) for name in (*sorted(members), *_STACK) if name in installed}


def git_state(file: Path) -> dict[str, Any] | None:
  """Return commit and uncommitted changes of the repository that tracks `file`; None without one."""
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
