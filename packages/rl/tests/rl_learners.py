"""Small learners of the toy environment, their exact comparison, and what a GPU would wait for."""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from mjlab_core import seed_everything
from mjlab_rl import (
  CheckpointPolicy,
  Console,
  MjlabOnPolicyRunner,
  OnnxPolicy,
  RslRlModelCfg,
  RslRlOnPolicyRunnerCfg,
  RslRlVecEnvWrapper,
)
from rl_point_env import PointEnv, PointEnvCfg, PointSceneCfg
from torch.utils._python_dispatch import TorchDispatchMode

QUIET = Console("quiet")


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

  Drawing from a normal looks whether a deviation is negative. Writing one number where a mask is True needs no wait.
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
