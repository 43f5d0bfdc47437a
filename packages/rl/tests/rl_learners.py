"""Small learners of the toy environment, their exact comparison, and what a GPU would wait for."""

import functools
import io
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from mjlab_core import seed_everything
from mjlab_core.errors import ConfigError
from mjlab_rl import (
  CheckpointPolicy,
  Console,
  MjlabOnPolicyRunner,
  OnnxPolicy,
  RslRlBaseRunnerCfg,
  RslRlModelCfg,
  RslRlOnPolicyRunnerCfg,
  RslRlVecEnvWrapper,
)
from mjlab_rl.processes.ranks import Ranks
from rl_point_env import PointEnv, PointEnvCfg, PointSceneCfg
from torch import distributed
from torch.utils._python_dispatch import TorchDispatchMode

QUIET = Console("quiet")


class Terminal(io.StringIO):
  def isatty(self) -> bool:
    return True


def agent(iterations: int = 4, hidden: tuple[int, ...] = (8,), **changes: Any) -> RslRlOnPolicyRunnerCfg:
  cfg = RslRlOnPolicyRunnerCfg(max_iterations=iterations, num_steps_per_env=6, save_interval=100, logger="none")
  cfg.actor.hidden_dims = hidden
  cfg.actor.obs_normalization = True
  cfg.critic = RslRlModelCfg(hidden_dims=(8,), obs_normalization=True)
  for name, value in changes.items():
    setattr(cfg, name, value)
  return cfg


def runner(
  directory: Path | None,
  cfg: RslRlOnPolicyRunnerCfg,
  worlds: int = 4,
  console: Console = QUIET,
  env: type[PointEnv] = PointEnv,
) -> MjlabOnPolicyRunner:
  seed_everything(cfg.seed)
  made = env(PointEnvCfg(scene=PointSceneCfg(num_envs=worlds), seed=3))
  return MjlabOnPolicyRunner(RslRlVecEnvWrapper(made), cfg, directory, "cpu", console=console)


def learner(path: Path) -> dict[str, Any]:
  return torch.load(path, weights_only=True)


def assert_same(a: Any, b: Any) -> None:
  if isinstance(a, torch.Tensor):
    assert torch.equal(a, b)
  elif isinstance(a, dict):
    assert a.keys() == b.keys()
    for key in a:
      assert_same(a[key], b[key])
  elif isinstance(a, (list, tuple)):
    assert len(a) == len(b)
    for left, right in zip(a, b, strict=True):
      assert_same(left, right)
  else:
    assert a == b


def assert_same_checkpoints(first: Path, second: Path) -> None:
  states = [learner(path) for path in (first, second)]
  for state in states:
    state.get("mjlab", {}).pop("elapsed", None)
  assert_same(*states)


def assert_resumes_exactly(make: Callable[[Path], MjlabOnPolicyRunner], folder: Path, half: int = 2) -> None:
  """Hold a run that was resumed after half of its iterations against an uninterrupted one, bit for bit."""
  for name in ("whole", "half"):
    (folder / name).mkdir()
  make(folder / "whole").learn(2 * half, init_at_random_ep_len=True)
  make(folder / "half").learn(half, init_at_random_ep_len=True)
  resumed = make(folder / "half")
  torch.rand(17)
  resumed.load(str(folder / "half" / f"model_{half}.pt"))
  resumed.learn(half)
  assert_same_checkpoints(*(folder / name / f"model_{2 * half}.pt" for name in ("whole", "half")))


def exported(policy: CheckpointPolicy, cfg: Any, env: PointEnv, folder: Path) -> OnnxPolicy:
  """Return a policy that was exported and read again."""
  with warnings.catch_warnings():
    # The exporter's own are not ours.
    warnings.simplefilter("ignore")
    policy._runner.export_policy_to_onnx(str(folder))
  return OnnxPolicy(folder / "policy.onnx", cfg, env)


class Waits(TorchDispatchMode):
  """Operations for which a GPU would be waited for.

  `torch.normal` reads back whether a deviation is negative. Writing one number where a mask is True does not wait.
  """

  words = ("_local_scalar_dense", "nonzero", "is_nonzero", "masked_select", "aten.normal.Tensor")

  def __init__(self) -> None:
    super().__init__()
    self.found: list[str] = []

  def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
    masks = [i for x in args if isinstance(x, list | tuple) for i in x if isinstance(i, torch.Tensor)]
    is_one = "aten.index_put" in str(func) and args[2].numel() == 1
    by_mask = "aten.index" in str(func) and not is_one and any(mask.dtype == torch.bool for mask in masks)
    if by_mask or any(word in str(func) for word in (*self.words, "aten.equal", "unique")):
      self.found.append(str(func))
    return func(*args, **(kwargs or {}))


def assert_no_waits(trained: MjlabOnPolicyRunner) -> None:
  """Check that a rollout reads nothing back, because reading stops a GPU."""
  with Waits() as waits:
    trained._collect(trained.env.get_observations())
  assert waits.found == []


def refuse_setting(cfg: RslRlBaseRunnerCfg, path: str, value: object, message: str) -> None:
  """Check that a configuration with another value of a field is refused."""
  *parts, last = path.split(".")
  setattr(functools.reduce(getattr, parts, cfg), last, value)
  with pytest.raises(ConfigError, match=message):
    cfg.to_rsl_rl()


def pretend_two_processes(monkeypatch: pytest.MonkeyPatch) -> None:
  """Let this process believe that a second one has the same worlds."""

  def all_reduce(numbers: torch.Tensor, op: Any = distributed.ReduceOp.SUM) -> None:
    if op == distributed.ReduceOp.SUM:
      numbers.mul_(2)

  monkeypatch.setattr(Ranks, "current", lambda: Ranks(world_size=2))
  monkeypatch.setattr(Ranks, "gather", lambda _, value: [value, value])
  monkeypatch.setattr(distributed, "get_world_size", lambda: 2)
  monkeypatch.setattr(distributed, "all_reduce", all_reduce)
  # Older versions of rsl-rl send the weights as objects.
  for name in ("broadcast", "broadcast_object_list"):
    monkeypatch.setattr(distributed, name, lambda values, src: None)


def assert_learned_the_same(one: dict[str, Any], two: dict[str, Any]) -> None:
  """Compare the states of a learner and of one of two processes with the same worlds, which count twice as much."""
  pairs = list(zip(*(_leaves(state) for state in (one, two)), strict=True))
  counts = [(a, b) for name, a, b in ((x[0], x[1], y[1]) for x, y in pairs) if name.endswith(".count")]
  assert counts
  assert all(b == 2 * a for a, b in counts)
  for (name, a), (_, b) in pairs:
    if not name.endswith(".count"):
      torch.testing.assert_close(b, a, rtol=1e-4, atol=1e-5, msg=lambda text, n=name: f"{n}: {text}")


def _leaves(state: Any, name: str = "") -> Iterator[tuple[str, Any]]:
  if isinstance(state, (dict, list, tuple)):
    for key, value in state.items() if isinstance(state, dict) else enumerate(state):
      yield from _leaves(value, f"{name}.{key}")
  elif state is not None:
    yield name, state
