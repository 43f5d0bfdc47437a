"""Environment with a point on a line in each world, pushed by the action."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch


@dataclass(kw_only=True)
class PointSceneCfg:
  num_envs: int = 4
  """Number of worlds."""


@dataclass(kw_only=True)
class PointTermCfg:
  func: Callable[..., Any]
  params: dict[str, Any] = field(default_factory=dict)


@dataclass(kw_only=True)
class PointEntityCfg:
  spec_fn: Callable[[], PointSceneCfg]
  edit_fn: Callable[[PointSceneCfg], None] | None = None


def point_scene(num_envs: int = 4) -> PointSceneCfg:
  return PointSceneCfg(num_envs=num_envs)


def point_reward(env: "PointEnv", *, weight: float = 1.0) -> torch.Tensor:
  return weight * env.state[:, 0]


def play(cfg: "PointEnvCfg") -> "PointEnvCfg":
  return cfg


@dataclass(kw_only=True)
class PointEnvCfg:
  scene: PointSceneCfg = field(default_factory=PointSceneCfg)
  episode_steps: int = 12
  """Length of a full episode [steps]."""
  noise: float = 0.05
  """Standard deviation of the push that each step adds."""
  gains: tuple[float, float] = (1.0, 0.5)
  """Weights of position and velocity."""
  rewards: dict[str, Any] = field(default_factory=dict)
  terms: dict[str, PointTermCfg] = field(default_factory=dict)
  entities: dict[str, PointEntityCfg] = field(default_factory=dict)
  output_dir: str | None = None
  seed: int | None = None
  is_finite_horizon: bool = False
  capture_terminal_observations: bool = False


@dataclass
class Actions:
  total_action_dim: int


class PointEnv:
  def __init__(self, cfg: PointEnvCfg, *, device: str = "cpu"):
    self.cfg = cfg
    self.num_envs = cfg.scene.num_envs
    self.device = torch.device(device)
    self.max_episode_length = cfg.episode_steps
    self.action_manager = Actions(1)
    self.rng = torch.Generator(device).manual_seed(cfg.seed or 0)
    self.state = torch.zeros(self.num_envs, 2, device=device)
    self.episode_length_buf = torch.zeros(self.num_envs, dtype=torch.int64, device=device)
    self.steps = torch.zeros((), dtype=torch.int64, device=device)
    self.last_action = torch.zeros(self.num_envs, 1, device=device)
    self._log = torch.zeros((), device=device)
    self.is_closed = False
    self.output_dir: Path | None = None

  def reset(self, *, seed: int | None = None) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    if seed is not None:
      self.rng.manual_seed(seed)
    self._restart(torch.ones(self.num_envs, dtype=torch.bool))
    return self.get_observations(), {}

  def step(self, action: torch.Tensor) -> tuple[dict[str, torch.Tensor], Any, Any, Any, dict[str, Any]]:
    self.last_action.copy_(action)
    self.state[:, 1] += 0.1 * action[:, 0] + self.cfg.noise * torch.randn(self.num_envs, generator=self.rng)
    self.state[:, 0] += 0.1 * self.state[:, 1]
    self.episode_length_buf += 1
    self.steps += 1
    reward = 1.0 - self.state.square() @ torch.tensor(self.cfg.gains)
    terminated = self.state[:, 0].abs() > 1.0
    truncated = self.episode_length_buf >= self.max_episode_length
    self._log += reward.mean()
    final = {"final_obs": self.get_observations()} if self.cfg.capture_terminal_observations else {}
    self._restart(terminated | truncated)
    return self.get_observations(), reward, terminated, truncated, final

  def get_observations(self) -> dict[str, torch.Tensor]:
    return {"actor": self.state.clone(), "critic": torch.cat((self.state, self.episode_length_buf[:, None] / 12), 1)}

  def drain_log(self) -> dict[str, float]:
    value = float(self._log)
    self._log.zero_()
    return {"Episode_Reward/point": value, "bare": 1.0}

  def state_dict(self) -> dict[str, Any]:
    return {
      "state": self.state.clone(),
      "ages": self.episode_length_buf.clone(),
      "steps": self.steps.clone(),
      "rng": self.rng.get_state(),
    }

  def load_state_dict(self, state: dict[str, Any]) -> None:
    self.state.copy_(state["state"])
    self.episode_length_buf.copy_(state["ages"])
    self.rng.set_state(state["rng"])
    self.load_progress(state)

  def load_progress(self, state: dict[str, Any]) -> None:
    self.steps.copy_(state["steps"])

  def close(self) -> None:
    self.is_closed = True

  def _restart(self, mask: torch.Tensor) -> None:
    draw = 0.5 * torch.randn(self.num_envs, 2, generator=self.rng)
    self.state.copy_(torch.where(mask[:, None], draw, self.state))
    self.episode_length_buf.masked_fill_(mask, 0)
