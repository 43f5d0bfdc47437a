"""Any failure of reading a file from a user is one line that begins with the kind and the name of the file.

300 mutations of each kind of file are tried: of its bytes, and of the values in it.
"""

import copy
import json
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import rl_point_env
import torch
from mjlab_core.errors import FileError
from mjlab_rl import OnnxPolicy, RslRlOnPolicyRunnerCfg, RunManifest, load_run
from mjlab_rl.runs.manifest import encode_manifest
from rl_learners import agent, learner, runner
from rl_onnx_files import linear_policy

COUNT = 300
ODD: list[Any] = [None, True, -1, 0, 1 << 70, 0.5, "", "x", [], {}, [1, "a"], {"x": 1}, "abc" * 50, float("nan")]
ODD_JSON: list[Any] = [
  *ODD[:-1],
  *(
    {tag: body}
    for tag in ("$ref", "$type", "$enum", "$float", "$tuple", "$set", "$slice", "$array")
    for body in ("", 5)
  ),
  {"$ref": "rl_point_env:play"},
  {"$set": [[1]]},
  {"$dict": [[{}, 1]]},
  {"$range": [1, 2]},
  {"$type": "rl_point_env:PointSceneCfg", "fields": {"num_envs": "x"}},
]


def places(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
  """Yield the path of every value in nested containers."""
  if at:
    yield at
  items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, (list, tuple)) else ()
  for key, item in items:
    yield from places(item, (*at, key))


def changed(value: Any, at: tuple[Any, ...], new: Callable[[Any], Any] | None) -> Any:
  """Return a copy with another value at a path; None removes it."""
  if not at:
    return new(value) if new is not None else None
  key, *rest = at
  items = dict(value) if isinstance(value, dict) else dict(enumerate(value))
  if new is None and not rest:
    del items[key]
  else:
    items[key] = changed(items[key], tuple(rest), new)
  return items if isinstance(value, dict) else type(value)(items.values())


def spoilt_bytes(content: bytes, rng: random.Random) -> bytes:
  kind, at = rng.randrange(4), rng.randrange(len(content))
  if kind == 0:
    return content[:at]
  if kind == 1:
    return content[:at] + content[at + rng.randrange(1, 64) :]
  body = bytearray(content)
  for _ in range(rng.randrange(1, 30)):
    body[rng.randrange(len(body))] = rng.randrange(256)
  return bytes(body) if kind == 2 else content[:at] + bytes(body[:64]) + content[at:]


def check(what: str, file: Path, read: Callable[[], object]) -> bool:
  """Return True if the file was refused in one line, False if it was read."""
  try:
    read()
  except FileError as error:
    message = str(error)
    assert message.startswith(f"{what} {file}"), message
    assert message.isprintable()
    return True
  return False


def test_a_mutated_manifest_is_read_or_refused_in_one_line(tmp_path: Path) -> None:
  rng = random.Random(0)
  terms = {"t": rl_point_env.PointTermCfg(func=rl_point_env.point_reward, params={"weight": 2.0})}
  cfg = RslRlOnPolicyRunnerCfg(clip_actions=1.0)
  run = RunManifest(task="T", env=rl_point_env.PointEnvCfg(terms=terms), agent=cfg, play=rl_point_env.play)
  manifest = encode_manifest(run)
  file = tmp_path / "manifest.json"
  text, paths, refused = json.dumps(manifest).encode(), list(places(manifest)), 0
  for i in range(COUNT):
    if i % 4 == 0:
      file.write_bytes(spoilt_bytes(text, rng))
    else:
      odd = rng.choice(ODD_JSON)
      file.write_text(json.dumps(changed(manifest, rng.choice(paths), None if i % 4 == 1 else lambda _, o=odd: o)))
    refused += check("manifest", file, lambda: load_run(tmp_path))
  assert COUNT // 2 < refused < COUNT


def _tensors(rng: random.Random) -> Any:
  return rng.choice(
    [
      lambda t: t.to(torch.complex64),
      lambda t: t.to(torch.int64),
      lambda t: t.reshape(-1)[:1],
      lambda t: t.to_sparse() if t.dim() else t,
      lambda t: torch.full_like(t.float(), float("inf")),
      lambda t: t.new_zeros(()).expand(1000, 1000, 1000),
      lambda t: t.tolist(),
    ]
  )


def test_a_mutated_checkpoint_is_read_or_refused_in_one_line(tmp_path: Path) -> None:
  rng = random.Random(0)
  cfg = agent(hidden=(4,))
  cfg.actor.rnn_type, cfg.actor.rnn_hidden_dim = "lstm", 4
  trained = runner(None, cfg)
  trained.learn(1)
  file = tmp_path / "model_1.pt"
  trained.save(str(file))
  content = file.read_bytes()
  state = learner(file)
  # The 625 numbers of a generator's state would take most of the mutations.
  paths = [
    path for path in places(state) if len(path) < 6 and not (path[:3] == ("mjlab", "rng", "python") and path[4:])
  ]
  refused = 0
  for i in range(COUNT):
    if i % 4 == 0:
      file.write_bytes(spoilt_bytes(content, rng))
    else:
      odd, of_tensor = rng.choice(ODD), _tensors(rng)
      new = lambda old, o=odd, f=of_tensor: f(old) if isinstance(old, torch.Tensor) and o != 0.5 else o  # noqa: E731
      torch.save(changed(state, rng.choice(paths), None if i % 4 == 1 else new), file)
    refused += check("checkpoint", file, lambda: trained.load(str(file)))
  assert COUNT // 3 < refused < COUNT
  file.write_bytes(content)
  trained.load(str(file))
  trained.learn(1)


def _spoil_model(model: Any, rng: random.Random) -> None:
  graph, number = model.graph, rng.randrange
  values = [*graph.input, *graph.output]
  spoil = rng.choice([
    lambda: graph.ClearField("input"),
    lambda: graph.ClearField("output"),
    lambda: graph.ClearField("initializer"),
    lambda: graph.ClearField("node"),
    lambda: graph.input.pop(number(len(graph.input))),
    lambda: graph.output.pop(number(len(graph.output))),
    lambda: graph.node.pop(number(len(graph.node))),
    lambda: rng.choice(values).type.tensor_type.ClearField("shape"),
    lambda: setattr(rng.choice(values).type.tensor_type, "elem_type", number(30)),
    lambda: rng.choice(values).type.tensor_type.shape.dim.add(dim_value=number(9)),
    lambda: setattr(rng.choice(values), "name", rng.choice(["", "x", "h_in", "time_step", "actions", "critic"])),
    lambda: setattr(rng.choice(graph.node), "op_type", rng.choice(["Nope", "Loop", "Relu", "Gather"])),
    lambda: setattr(rng.choice(graph.node), "domain", "evil"),
    lambda: setattr(rng.choice(graph.initializer), "raw_data", bytes(number(50))),
    lambda: setattr(rng.choice(graph.initializer), "data_location", onnx.TensorProto.EXTERNAL),
    lambda: model.metadata_props.add(key=rng.choice(["joint_names", "x"]), value=rng.choice(["", ",", "\x1b", "a,b"])),
    lambda: model.opset_import.pop(),
  ])  # fmt: skip
  spoil()


@pytest.mark.parametrize("spoil_twice", [False, True])
def test_a_mutated_onnx_file_is_read_or_refused_in_one_line(tmp_path: Path, spoil_twice: bool) -> None:
  rng = random.Random(spoil_twice)
  env = rl_point_env.PointEnv(rl_point_env.PointEnvCfg())
  file = linear_policy(tmp_path / "policy.onnx", np.ones((2, 1)), time_step=True, memory=True)
  content, model, refused = file.read_bytes(), onnx.load(file), 0
  for i in range(COUNT // 2):
    if i % 3 == 0:
      file.write_bytes(spoilt_bytes(content, rng))
    else:
      spoilt = copy.deepcopy(model)
      _spoil_model(spoilt, rng)
      if spoil_twice and spoilt.graph.node and spoilt.graph.initializer and spoilt.graph.input and spoilt.graph.output:
        _spoil_model(spoilt, rng)
      file.write_bytes(spoilt.SerializeToString())
    refused += check("policy", file, lambda: OnnxPolicy(file, RslRlOnPolicyRunnerCfg(), env)(env.get_observations()))
  assert COUNT // 5 < refused < COUNT // 2
