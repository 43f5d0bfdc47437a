"""Terms that torch.compile compiles give the numbers of terms that it does not."""

import functools
from typing import Any

import pytest
import torch
from envs_hopper import Make, actions, hopper_cfg
from mjlab_managers import ManagerTermBase, MetricsTermCfg, ObservationTermCfg, RewardTermCfg


class travelled(ManagerTermBase):
  """Height summed over the episode."""

  def __init__(self, env: Any, *, scale: float) -> None:
    super().__init__(env)
    self._scale, self.sum = scale, self.state()

  def __call__(self) -> torch.Tensor:
    return self.sum.add_(self._scale * self.env.scene["robot"].data.root_link_pos_w[:, 2])


def drawn(env: Any) -> torch.Tensor:
  return torch.rand(env.num_envs, generator=env.rng, device=env.device)


def read_by_host(env: Any) -> torch.Tensor:
  return torch.full((env.num_envs,), float(env.sim.data.qpos.sum()), device=env.device)


@pytest.fixture(autouse=True)
def quick_compiler(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
  # The same trace and the same changes to memory, without code to compile, which takes many seconds.
  compile_eagerly = functools.partial(torch.compile, backend="aot_eager")
  is_warp = "warp" in request.node.name
  monkeypatch.setattr(torch, "compile", (lambda graph, **_: graph) if is_warp else compile_eagerly)


def test_compiled_terms_give_the_same_numbers_and_state(make: Make, engine: str) -> None:
  envs = []
  for is_compiled in (False, True):
    cfg = hopper_cfg(engine=engine, compile_terms=is_compiled, episode_length_s=0.03)
    cfg.rewards["travelled"] = RewardTermCfg(travelled, weight=0.5, params={"scale": 2.0})
    cfg.rewards["drawn"] = RewardTermCfg(drawn, weight=0.1)
    cfg.metrics["read"] = MetricsTermCfg(read_by_host)
    cfg.observations["actor"].terms["drawn"] = ObservationTermCfg(lambda env: drawn(env)[:, None])
    envs.append(make(cfg))
  plain, compiled = envs
  for env in envs:
    env.reset(seed=3)
  ended = 0
  for seed in range(8):
    for env in envs if seed == 4 else ():
      env.reward_manager.set_params("travelled", scale=3.0)
      env.reward_manager.get_term_cfg("alive").weight = 0.0
    steps = [env.step(actions(env, seed)) for env in envs]
    torch.testing.assert_close(*steps)
    ended += int((steps[0][2] | steps[0][3]).sum())
  assert ended > 0
  torch.testing.assert_close(plain.state_dict(), compiled.state_dict())
  torch.testing.assert_close(plain.drain_log(), compiled.drain_log())


def test_terms_that_draw_or_read_the_device_stay_as_they_are(make: Make, caplog: pytest.LogCaptureFixture) -> None:
  cfg = hopper_cfg(compile_terms=True)
  cfg.rewards = {"drawn": RewardTermCfg(drawn, weight=1.0), "read": RewardTermCfg(read_by_host, weight=1.0)}
  cfg.rewards["travelled"] = RewardTermCfg(travelled, weight=0.5, params={"scale": 2.0})
  env = make(cfg)
  with caplog.at_level("INFO", "mjlab"):
    env.reset()
    env.step(actions(env, 0))
  assert "RewardManager: 1 terms compiled; as they are: drawn, read" in caplog.messages
