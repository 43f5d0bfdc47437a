"""Off-policy learners on Gymnasium's Pendulum-v1, beside the published result of SAC.

  uv run python tools/parity_pendulum.py --output docs/benchmarks/learners_pendulum.md

RL Baselines3 Zoo lists SAC on Pendulum-v1 after 20 000 steps with a return of -157 +- 89, mean and standard
deviation of 750 episodes. Here 16 worlds make 1250 steps each, 20 000 in all, with 10 000 updates of 256
transitions, and the mean action of the last policy is evaluated in 750 episodes of Gymnasium's own
environment. Two cores, about half an hour.
"""

import argparse
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.envs.classic_control import PendulumEnv
from mjlab_rl import Console, OffPolicyRunnerCfg, RslRlOnPolicyRunnerCfg
from mjlab_rl.offpolicy import PRESETS
from mjlab_rl.offpolicy.runner import MjlabOffPolicyRunner
from mjlab_rl.vec_env import RslRlVecEnvWrapper

PUBLISHED = (-156.995, 88.714)
WORLDS, STEPS, EPISODE = 16, 1250, 200


@dataclass(kw_only=True)
class SceneCfg:
  """Scene of the pendulums."""

  num_envs: int = WORLDS
  """Number of worlds."""


@dataclass(kw_only=True)
class PendulumCfg:
  """Environment of the pendulums."""

  scene: SceneCfg = field(default_factory=SceneCfg)
  seed: int | None = None
  is_finite_horizon: bool = False
  capture_terminal_observations: bool = True


@dataclass
class Actions:
  """Action manager, as far as a learner reads it."""

  total_action_dim: int


class Pendulum:
  """Gymnasium's Pendulum-v1 for many worlds: an environment of our own that the learners take."""

  def __init__(self, cfg: PendulumCfg) -> None:
    self.cfg, self.num_envs, self.device = cfg, cfg.scene.num_envs, torch.device("cpu")
    self.max_episode_length = EPISODE
    self.output_dir: Path | None = None
    self.action_manager = Actions(1)
    self.rng = torch.Generator().manual_seed(cfg.seed or 0)
    self.angle, self.speed = torch.zeros(self.num_envs), torch.zeros(self.num_envs)
    self.episode_length_buf = torch.zeros(self.num_envs, dtype=torch.int64)

  def reset(self, *, seed: int | None = None) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    if seed is not None:
      self.rng.manual_seed(seed)
    self._restart(torch.ones(self.num_envs, dtype=torch.bool))
    return self.get_observations(), {}

  def step(self, action: torch.Tensor) -> tuple[dict[str, torch.Tensor], Any, Any, Any, dict[str, Any]]:
    torque = action[:, 0].clamp(-2.0, 2.0)
    angle = (self.angle + torch.pi) % (2.0 * torch.pi) - torch.pi
    reward = -(angle.square() + 0.1 * self.speed.square() + 0.001 * torque.square())
    # g = 10 m/s^2, m = 1 kg, l = 1 m, dt = 0.05 s
    self.speed = (self.speed + (15.0 * torch.sin(self.angle) + 3.0 * torque) * 0.05).clamp(-8.0, 8.0)
    self.angle = self.angle + 0.05 * self.speed
    self.episode_length_buf += 1
    truncated = self.episode_length_buf >= EPISODE
    extras = {"final_obs": self.get_observations()}
    self._restart(truncated)
    return self.get_observations(), reward, torch.zeros_like(truncated), truncated, extras

  def get_observations(self) -> dict[str, torch.Tensor]:
    seen = torch.stack((self.angle.cos(), self.angle.sin(), self.speed), 1)
    return {"actor": seen, "critic": seen}

  def _restart(self, mask: torch.Tensor) -> None:
    start = torch.rand(2, self.num_envs, generator=self.rng) * 2.0 - 1.0
    self.angle, self.speed = torch.where(mask, torch.pi * start[0], self.angle), torch.where(mask, start[1], self.speed)
    self.episode_length_buf[mask] = 0

  def drain_log(self) -> dict[str, float]:
    return {}

  def state_dict(self) -> dict[str, Any]:
    return {}

  def load_state_dict(self, state: dict[str, Any]) -> None:
    del state

  def load_progress(self, state: dict[str, Any]) -> None:
    del state

  @property
  def unwrapped(self) -> "Pendulum":
    return self

  def close(self) -> None:
    pass


def difference_from_gymnasium() -> float:
  """Return the largest difference of observations and rewards from Gymnasium's pendulum over 500 steps."""
  env, other = Pendulum(PendulumCfg(scene=SceneCfg(num_envs=1))), PendulumEnv()
  other.reset(seed=0)
  rng, largest = np.random.default_rng(0), 0.0
  for step in range(500):
    if step % EPISODE == 0:
      env.reset(seed=step)
      other.state = np.array([float(env.angle[0]), float(env.speed[0])])
    action = rng.uniform(-2.5, 2.5)
    expected, reward, *_ = other.step(np.array([action], np.float32))
    _, found, _, _, extras = env.step(torch.tensor([[action]]))
    seen = extras["final_obs"]["actor"][0].numpy()
    largest = max(largest, float(np.abs(seen - expected).max()), abs(float(found[0]) - float(reward)))
  return largest


def settings(preset: str, seed: int, steps: int = STEPS, updates: float = 8.0) -> OffPolicyRunnerCfg:
  """Return a preset with the discount, batch and networks of the published run's size."""
  agent = PRESETS[preset](RslRlOnPolicyRunnerCfg(seed=seed, obs_groups={"actor": ("actor",), "critic": ("critic",)}))
  agent.max_iterations, agent.num_steps_per_env, agent.save_interval = steps // 25, 25, 10**6
  agent.actor.hidden_dims, agent.critic.hidden_dims = (64, 64), (64, 64)
  algorithm = agent.algorithm
  algorithm.batch_size, algorithm.updates_per_step, algorithm.learning_starts = 256, updates, 10
  algorithm.replay_steps, algorithm.gamma, algorithm.action_bound = steps, 0.98, 2.0
  # Rewards of -16 to 0 do not fit the values of FastSAC, which are those of rewards times the step.
  algorithm.return_scaling = True
  return agent


def train(agent: OffPolicyRunnerCfg, seed: int) -> MjlabOffPolicyRunner:
  torch.manual_seed(seed)
  env = Pendulum(PendulumCfg(seed=seed))
  runner = MjlabOffPolicyRunner(RslRlVecEnvWrapper(env), agent, device="cpu", console=Console("quiet"))
  runner.learn(agent.max_iterations)
  return runner


@torch.inference_mode()
def returns_of(runner: MjlabOffPolicyRunner, episodes: int = 750) -> np.ndarray:
  """Return the return of each episode in Gymnasium's environment under the mean action."""
  policy = runner.get_inference_policy("cpu")
  env = gymnasium.make_vec("Pendulum-v1", episodes)
  obs, _ = env.reset(seed=0)
  total = np.zeros(episodes)
  for _ in range(EPISODE):
    seen = torch.as_tensor(obs, dtype=torch.float32)
    action = policy({"actor": seen, "critic": seen})
    obs, reward, *_ = env.step(action.clamp(-2.0, 2.0).numpy())
    total += reward
  return total


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--seeds", type=int, default=3)
  parser.add_argument("--output", type=Path, required=True)
  args = parser.parse_args()
  print(f"largest difference from Gymnasium's pendulum: {difference_from_gymnasium():.1e}")
  lines = ["| learner | seed | return, mean of 750 episodes | standard deviation |", "|---|---:|---:|---:|"]
  lines.append(f"| SAC, published | | {PUBLISHED[0]:.0f} | {PUBLISHED[1]:.0f} |")
  for preset in PRESETS:
    for seed in range(1, args.seeds + 1):
      returns = returns_of(train(settings(preset, seed), seed))
      lines.append(f"| {preset} | {seed} | {returns.mean():.0f} | {returns.std():.0f} |")
      print(lines[-1], flush=True)
  args.output.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
  main()
