"""Manifests that try to run code or to write files, and a watch over what a process does while it reads them."""

import contextlib
import functools
import json
import os
import sys
from collections.abc import Generator
from pathlib import Path
from typing import Any

_WATCHED = (
  "os.system os.exec os.posix_spawn os.spawn os.fork os.remove os.rename os.rmdir os.mkdir os.link os.symlink os.chmod "
  "os.truncate os.kill os.putenv subprocess.Popen shutil socket. webbrowser.open pty.spawn ctypes.dlopen tempfile "
  "urllib.Request http.client pickle.find_class"
).split()
_log: list[str] | None = None


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
  if _log is None:
    return
  if event.startswith(tuple(_WATCHED)):
    _log.append(f"{event}{arguments!r}")
  if event == "open" and isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
    _log.append(f"open{arguments!r}")


@functools.cache
def _install() -> None:
  sys.addaudithook(_hook)


@contextlib.contextmanager
def nothing_happens() -> Generator[None]:
  """Fail if a process is started, a connection opened, or a file written, renamed or removed in here."""
  global _log
  _install()
  before, sys.dont_write_bytecode = sys.dont_write_bytecode, True
  log: list[str] = []
  _log = log
  try:
    yield
  finally:
    _log = None
    sys.dont_write_bytecode = before
  assert not log, log


VICTIM = "victim"
"""File that hostile manifests try to write or remove."""

FOREIGN = """
os:system posix:system subprocess:run subprocess:Popen builtins:eval builtins:exec builtins:__import__ builtins:open
builtins:compile builtins:getattr importlib:import_module importlib:reload importlib.util:spec_from_file_location
pickle:loads pickle:load marshal:loads shelve:open shutil:rmtree shutil:move pathlib:Path pathlib:Path.unlink
pathlib:Path.write_text operator:attrgetter operator:methodcaller operator:itemgetter functools:partial
functools:reduce types:FunctionType types:CodeType types:MethodType ctypes:CDLL code:interact webbrowser:open
runpy:run_path timeit:timeit pty:spawn socket:create_connection urllib.request:urlopen http.server:test
multiprocessing:Process threading:Thread threading:Timer atexit:register signal:signal sys:exit sys:setprofile
os:remove os:kill os:execv os:_exit zipfile:main pip:main torch:load torch.hub:load
torch.utils.cpp_extension:load_inline numpy:load numpy:save math:sqrt rsl_rl.utils:resolve_callable
rsl_rl.utils.utils:resolve_callable msgspec.json:decode antigravity:geohash __main__:x mjlab_evil:run mjlabrl:x
""".split()
"""Callables outside trusted packages."""

WALKS = """
mjlab_core:os.system mjlab_core.io.files:os.system mjlab_core.io.files:os mjlab_core.io.files:shutil.rmtree
mjlab_core.io.files:Path.unlink mjlab_rl.runs.manifest:subprocess.run mjlab_rl.runs.manifest:subprocess.Popen
mjlab_rl.runs.manifest:os.system mjlab_rl.runs.manifest:Path mjlab_rl.runs.manifest:Path.write_text
mjlab_rl.runs.manifest:reading
mjlab_rl.runs.manifest:json.loads mjlab_rl.runs.checkpoint:torch.load mjlab_rl.runs.checkpoint:pickle.loads
mjlab_rl.runs.references:importlib.import_module mjlab_rl.runs.references:sys.modules.os
mjlab_rl.runs.manifest:load_run.__globals__ mjlab_rl.runs.manifest:load_run.__code__
mjlab_core.io.files:AtomicWrite.__init__.__globals__ mjlab_rl.config:__builtins__.eval mjlab_rl:__loader__
mjlab_rl.runs.manifest:RunManifest.__subclasses__ mjlab_rl.runs.manifest:RunManifest.__class__
mjlab_rl.runs.manifest:RunManifest.__init__ mjlab_core.io.files:_COUNTER mjlab_core.io.files:_WRITING.add
mjlab_rl.runs.manifest:_MAX_BYTES mjlab_rl.os:system mjlab_rl.runs.manifest.os:system mjlab_rl.__init__:train
mjlab_rl:train
""".split()
"""Ways from a trusted package to something that is not defined in it."""

MALFORMED: list[Any] = [
  "", ":", "os", ":system", "mjlab_rl", "mjlab_rl:", "mjlab_rl..manifest:load_run", "../x:y", "mjlab_rl/../os:system",
  "mjlab_rl.runs.manifest:load_run\n", "mjlab_rl.runs.manifest: load_run", "ｏｓ:system",
  "mjlab_rl.runs.manifest:load_run()", "mjlab_rl.runs.manifest:load_run:x", "\x1b[31mos:system", "x" * 5000, 3, None,
  ["os", "system"], {"$ref": "os:system"},
]  # fmt: skip


def partial(target: Any, *args: Any, **keywords: Any) -> dict[str, Any]:
  """Return the data of a partial."""
  return {"$partial": target if isinstance(target, dict) else {"$ref": target}, "args": args, "keywords": keywords}


def _path(name: str = VICTIM) -> dict[str, str]:
  return {"$path": name}


_CHECKPOINT = "mjlab_rl.runs.checkpoint:write_checkpoint"
_TERM = "rl_point_env:PointTermCfg"
_ENTITY = "rl_point_env:PointEntityCfg"


def _term(func: Any, **params: Any) -> dict[str, Any]:
  return {"$type": _TERM, "fields": {"func": func, "params": params}}


def _entity(**fields: Any) -> dict[str, Any]:
  return {"$type": _ENTITY, "fields": fields}


PLACED: list[tuple[str, Any]] = [
  # Partials: of anything foreign, of partials, and of trusted functions that do harm with chosen arguments.
  ("play", partial("os:system", f"touch {VICTIM}")),
  ("play", partial(partial("os:system", f"touch {VICTIM}"))),
  ("play", partial("functools:partial", {"$ref": "os:system"}, f"touch {VICTIM}")),
  ("play", partial("operator:methodcaller", "unlink")),
  ("play", partial({"$type": "subprocess:Popen", "fields": {}})),
  ("play", partial("mjlab_rl.runs.manifest:_git", _path("."), "-c", f"alias.x=!touch {VICTIM}")),
  ("play", {"$ref": "mjlab_core.io.files:remove_leftovers"}),
  ("play", {"$ref": "mjlab.cli:main"}),
  ("play", partial("mjlab.cli:main", ["export-scene", "x", "--force"])),
  ("make_env", partial("subprocess:run", f"touch {VICTIM}", shell=True)),
  ("make_env", partial(_CHECKPOINT, _path())),
  ("make_env", {"$ref": "mjlab_core.io.files:AtomicWrite"}),
  ("make_env", {"$ref": "mjlab_core.io.files:remove_leftovers"}),
  ("runner", {"$ref": "subprocess:Popen"}),
  ("runner", {"$ref": "mjlab_core.io.files:AtomicWrite"}),
  ("runner", {"$ref": "mjlab_rl.runs.manifest:load_run"}),
  ("env.fields.rewards.f", partial("os:system", f"touch {VICTIM}")),
  ("env.fields.rewards.f", partial(_CHECKPOINT, _path(), {})),
  ("env.fields.rewards.f", [{"deep": partial(_CHECKPOINT, _path(), {})}]),
  ("env.fields.terms.t", _term(partial(_CHECKPOINT, _path()))),
  ("env.fields.terms.t", _term({"$ref": _CHECKPOINT}, state={}, path=_path())),
  ("env.fields.terms.t", _term({"$ref": "mjlab_core.io.files:AtomicWrite"}, path=_path())),
  ("env.fields.terms.t", _term({"$ref": "mjlab_rl.vec_env:RslRlVecEnvWrapper"})),
  ("env.fields.terms.t", _term(partial("rl_point_env:point_reward", 1.0))),
  ("env.fields.terms.t", _term("os:system")),
  ("env.fields.entities.e", _entity(spec_fn=partial("os:system", f"touch {VICTIM}"))),
  ("env.fields.entities.e", _entity(spec_fn=partial("mjlab_rl.runs.manifest:_git", _path("."), "status"))),
  ("env.fields.entities.e", _entity(spec_fn=partial("mjlab_core.io.files:remove_leftovers", "."))),
  (
    "env.fields.entities.e",
    _entity(spec_fn={"$ref": "rl_point_env:point_scene"}, edit_fn=partial(_CHECKPOINT, _path())),
  ),
  ("env.fields.entities.e", _entity(spec_fn=partial("rl_point_env:point_scene", 1, 2, 3))),
  # Constructors.
  ("env", {"$type": "subprocess:Popen", "fields": {"args": f"touch {VICTIM}", "shell": True}}),
  ("env", {"$type": "mjlab_core.io.files:AtomicWrite", "fields": {"path": VICTIM}}),
  ("env", {"$type": "pathlib:Path", "fields": {}}),
  ("env", {"$type": "mjlab_rl.runs.manifest:load_run", "fields": {}}),
  ("env", {"$type": "mjlab_rl.config:RslRlModelCfg", "fields": {"__class__": 1}}),
  ("agent", {"$type": "mjlab_rl.config:RslRlModelCfg", "fields": {}}),
  ("env.fields.scene", {"$type": "mjlab_rl.config:RslRlModelCfg", "fields": {}}),
  ("env.fields.rewards.f", {"$enum": "os:system", "name": "x"}),
  ("env.fields.rewards.f", {"$enum": "mjlab_rl.runs.manifest:RunManifest", "name": "__init__"}),
  ("env.fields.rewards.f", {"$enum": "mujoco._enums:mjtGeom.__class__", "name": "mro"}),
  ("env.fields.rewards.f", {"$array": [{"$ref": "os:system"}], "dtype": "object", "shape": [1]}),
  ("env.fields.rewards.f", {"$array": [], "dtype": "float64", "shape": [1 << 40]}),
  # Names that rsl-rl would import and call.
  ("agent.fields.actor.fields.class_name", "os:system"),
  ("agent.fields.actor.fields.class_name", "os.system"),
  ("agent.fields.actor.fields.class_name", "subprocess:Popen"),
  ("agent.fields.actor.fields.class_name", "Popen"),
  ("agent.fields.actor.fields.class_name", "mjlab_core.io.files:AtomicWrite"),
  ("agent.fields.critic.fields.class_name", "torch:load"),
  ("agent.fields.critic.fields.class_name", "rsl_rl.utils.utils:resolve_callable"),
  ("agent.fields.algorithm.fields.class_name", "webbrowser:open"),
  ("agent.fields.actor.fields.distribution_cfg.class_name", "builtins:exec"),
  ("agent.fields.algorithm.fields.symmetry_cfg", {"data_augmentation_func": "os:system"}),
  ("agent.fields.algorithm.fields.symmetry_cfg", {"data_augmentation_func": _CHECKPOINT}),
  ("agent.fields.algorithm.fields.rnd_cfg", {"weight_schedule": {"class_name": "os:system"}}),
]
"""Places in a manifest, and what is put there."""


def put(manifest: dict[str, Any], place: str, payload: Any) -> dict[str, Any]:
  """Return a copy of a manifest with something else at a place."""
  copy: dict[str, Any] = json.loads(json.dumps(manifest))
  at = copy
  *path, last = place.split(".")
  for part in path:
    at = at.setdefault(part, {})
  at[last] = payload
  return copy


def hostile(manifest: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
  """Return all hostile variants of a manifest of the point task, each with the reference that its refusal must name."""
  found: list[tuple[str, dict[str, Any]]] = []
  for place in ("play", "env.fields.rewards.f"):
    found += [(name, put(manifest, place, {"$ref": name})) for name in (*FOREIGN, *WALKS)]
  found += [("", put(manifest, "make_env", {"$ref": name})) for name in MALFORMED]
  return found + [("", put(manifest, place, payload)) for place, payload in PLACED]


def write(folder: Path, manifest: dict[str, Any]) -> Path:
  """Write a manifest into a folder."""
  path = folder / "manifest.json"
  path.write_text(json.dumps(manifest))
  return path
