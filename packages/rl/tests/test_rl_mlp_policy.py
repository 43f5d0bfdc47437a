"""Policies that need torch alone."""

import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import pytest
import torch
from mjlab_core import FileError
from mjlab_rl import CheckpointPolicy, MlpPolicy, RslRlModelCfg, RslRlOnPolicyRunnerCfg
from mjlab_rl.network_entries import Activation
from rl_point_env import PointEnv, PointEnvCfg


def agent_of(activation: Any = "elu", std_type: str = "log", **model: Any) -> RslRlOnPolicyRunnerCfg:
  distribution = {"class_name": "GaussianDistribution", "init_std": 0.5, "std_type": std_type}
  actor = RslRlModelCfg(hidden_dims=(8, 5), activation=activation, distribution_cfg=distribution, **model)
  return RslRlOnPolicyRunnerCfg(actor=actor)


def checkpoint_of(env: PointEnv, agent: RslRlOnPolicyRunnerCfg, path: Path) -> CheckpointPolicy:
  """rsl-rl's own network with weights that it did not begin with, and their checkpoint."""
  policy = CheckpointPolicy(env, agent)
  for value in policy.network.state_dict().values():
    if value.is_floating_point():
      value.copy_(torch.rand(value.shape) + 0.1)
  torch.save({"actor_state_dict": policy.network.state_dict(), "iter": 3, "infos": None}, path)
  return policy


@pytest.mark.parametrize("activation", cast("Any", Activation).__args__)
def test_actions_are_bit_equal_to_those_of_rsl_rl(activation: str, tmp_path: Path) -> None:
  env = PointEnv(PointEnvCfg())
  for agent in (agent_of(activation), agent_of(activation, obs_normalization=True, std_type="scalar")):
    agent.clip_actions = 0.9
    theirs = checkpoint_of(env, agent, tmp_path / "model.pt")
    assert MlpPolicy.suits(env, agent)
    ours = MlpPolicy(env, agent)
    ours.load(tmp_path / "model.pt")
    seen = env.get_observations()
    with torch.no_grad():
      assert torch.equal(ours(seen), theirs(seen))


def test_a_checkpoint_of_another_network_is_refused_and_changes_nothing(tmp_path: Path) -> None:
  env = PointEnv(PointEnvCfg())
  checkpoint_of(env, agent_of(obs_normalization=True), tmp_path / "model.pt")
  policy = MlpPolicy(env, agent_of())
  before = policy(env.get_observations())
  with pytest.raises(FileError, match=r"obs_normalizer._mean is only in the file.*agent\.actor\.hidden_dims"):
    policy.load(tmp_path / "model.pt")
  assert torch.equal(policy(env.get_observations()), before)


def test_networks_other_than_plain_mlps_are_left_to_rsl_rl() -> None:
  env = PointEnv(PointEnvCfg())
  assert not MlpPolicy.suits(env, agent_of(rnn_type="gru"))
  assert not MlpPolicy.suits(env, agent_of(), type("Runner", (), {}))
  other = agent_of()
  other.actor.distribution_cfg = {"class_name": "HeteroscedasticGaussianDistribution"}
  assert not MlpPolicy.suits(env, other)
  misspelt = agent_of()
  misspelt.obs_groups["actor"] = ("acter",)
  assert not MlpPolicy.suits(env, misspelt)


def test_it_imports_no_rsl_rl() -> None:
  code = "import sys; from mjlab_rl import FinitePolicy, MlpPolicy; print(*sys.modules)"
  modules = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
  assert "torch" in modules
  assert not {"rsl_rl", "tensordict", "torch._dynamo"} & set(modules)
