"""Gymnasium's Pendulum-v1 and Hopper-v5 for many worlds: environments of our own that the learners take."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import torch
from mujoco import batch


@dataclass(kw_only=True)
class SceneCfg:
  """Scene of the worlds."""

  num_envs: int = 16
  """Number of worlds."""


@dataclass(kw_only=True)
class WorldsCfg:
  """Environment of the worlds."""

  scene: SceneCfg = field(default_factory=SceneCfg)
  seed: int | None = None
  is_finite_horizon: bool = False
  capture_terminal_observations: bool = True


@dataclass
class Actions:
  """Action manager, as far as a learner reads it."""

  total_action_dim: int


class Worlds(ABC):
  """One of Gymnasium's environments for many worlds, computed on the CPU.

  Args:
    cfg: Number of worlds and seed.
    device: Device of actions, observations, rewards and flags.
  """

  episode: ClassVar[int]
  """Steps after which an episode is cut."""
  num_actions: ClassVar[int]
  """Width of actions."""

  def __init__(self, cfg: WorldsCfg, device: str = "cpu") -> None:
    self.cfg, self.num_envs, self.device = cfg, cfg.scene.num_envs, torch.device(device)
    self.max_episode_length, self.output_dir = self.episode, None
    self.action_manager = Actions(self.num_actions)
    self.rng = torch.Generator().manual_seed(cfg.seed or 0)
    self.episode_length_buf = torch.zeros(self.num_envs, dtype=torch.int64)
    self.steps_done = 0
    self.returns: list[tuple[int, float]] = []
    """Steps of all worlds at the end of each episode so far, and its return."""
    self._return = torch.zeros(self.num_envs, dtype=torch.float64)

  @abstractmethod
  def restart(self, mask: torch.Tensor) -> None:
    """Draw new starts for the worlds in `mask`, bool (num_envs,)."""

  @abstractmethod
  def advance(self, action: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Step under actions (num_envs, num_actions); return rewards and terminations, (num_envs,)."""

  @abstractmethod
  def observe(self) -> torch.Tensor:
    """Return the observations, (num_envs, width)."""

  def reset(self, *, seed: int | None = None) -> tuple[dict[str, torch.Tensor], dict[str, Any]]:
    if seed is not None:
      self.rng.manual_seed(seed)
    self._begin(torch.ones(self.num_envs, dtype=torch.bool))
    return self.get_observations(), {}

  def step(self, action: torch.Tensor) -> tuple[dict[str, torch.Tensor], Any, Any, Any, dict[str, Any]]:
    reward, terminated = self.advance(action.cpu())
    self.episode_length_buf += 1
    self.steps_done += self.num_envs
    truncated = self.episode_length_buf >= self.episode
    self._return += reward
    over = terminated | truncated
    self.returns += [(self.steps_done, value) for value in self._return[over].tolist()]
    extras = {"final_obs": self.get_observations()}
    self._begin(over)
    reward, terminated, truncated = (part.to(self.device) for part in (reward.float(), terminated, truncated))
    return self.get_observations(), reward, terminated, truncated, extras

  def get_observations(self) -> dict[str, torch.Tensor]:
    seen = self.observe().float().to(self.device)
    return {"actor": seen, "critic": seen}

  def _begin(self, mask: torch.Tensor) -> None:
    if mask.any():
      self.restart(mask)
      self.episode_length_buf[mask] = 0
      self._return[mask] = 0.0

  def drain_log(self) -> dict[str, float]:
    return {}

  def state_dict(self) -> dict[str, Any]:
    return {}

  def load_state_dict(self, state: dict[str, Any]) -> None:
    del state

  def load_progress(self, state: dict[str, Any]) -> None:
    del state

  @property
  def unwrapped(self) -> "Worlds":
    return self

  def close(self) -> None:  # noqa: B027
    """Do nothing."""


class Pendulum(Worlds):
  """Pendulum-v1."""

  episode, num_actions = 200, 1

  def __init__(self, cfg: WorldsCfg, device: str = "cpu") -> None:
    super().__init__(cfg, device)
    self.angle, self.speed = torch.zeros(self.num_envs), torch.zeros(self.num_envs)

  def restart(self, mask: torch.Tensor) -> None:
    start = torch.rand(2, self.num_envs, generator=self.rng) * 2.0 - 1.0
    self.angle, self.speed = torch.where(mask, torch.pi * start[0], self.angle), torch.where(mask, start[1], self.speed)

  def advance(self, action: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    torque = action[:, 0].clamp(-2.0, 2.0)
    angle = (self.angle + torch.pi) % (2.0 * torch.pi) - torch.pi
    reward = -(angle.square() + 0.1 * self.speed.square() + 0.001 * torque.square())
    # g = 10 m/s^2, m = 1 kg, l = 1 m, dt = 0.05 s
    self.speed = (self.speed + (15.0 * torch.sin(self.angle) + 3.0 * torque) * 0.05).clamp(-8.0, 8.0)
    self.angle = self.angle + 0.05 * self.speed
    return reward, torch.zeros(self.num_envs, dtype=torch.bool)

  def observe(self) -> torch.Tensor:
    return torch.stack((self.angle.cos(), self.angle.sin(), self.speed), 1)


class Hopper(Worlds):
  """Hopper-v5, with the model of the installed Gymnasium and MuJoCo's own batch on all cores."""

  episode, num_actions = 1000, 3

  def __init__(self, cfg: WorldsCfg, device: str = "cpu") -> None:
    super().__init__(cfg, device)
    model = mujoco.MjModel.from_xml_path(str(hopper_model()))
    self._batch = batch.Batch(model, self.num_envs, persistent=True)
    self.qpos, self.qvel, self._ctrl = (torch.from_numpy(self._batch.bind(name)) for name in ("qpos", "qvel", "ctrl"))
    self._start = torch.from_numpy(model.qpos0)

  def restart(self, mask: torch.Tensor) -> None:
    self._batch.reset(mask.numpy(), stage=mujoco.mjtStage.mjSTAGE_NONE.value)
    noise = (torch.rand(self.num_envs, 12, generator=self.rng, dtype=torch.float64) * 2.0 - 1.0) * 5e-3
    self.qpos[mask], self.qvel[mask] = self._start + noise[mask, :6], noise[mask, 6:]

  def advance(self, action: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    before = self.qpos[:, 0].clone()
    self._ctrl.copy_(action)
    self._batch.step(nstep=4)
    height, angle = self.qpos[:, 1], self.qpos[:, 2]
    state = torch.cat((self.qpos[:, 2:], self.qvel), 1)
    is_healthy = (height > 0.7) & (angle.abs() < 0.2) & (state.abs() < 100.0).all(1)
    speed = (self.qpos[:, 0] - before) / 0.008
    return is_healthy + speed - 1e-3 * action.double().square().sum(1), ~is_healthy

  def observe(self) -> torch.Tensor:
    return torch.cat((self.qpos[:, 1:], self.qvel.clamp(-10.0, 10.0)), 1)


def hopper_model() -> Path:
  """Return the path of the model in the installed Gymnasium, whose package of it would import a renderer."""
  return Path(str(files("gymnasium"))) / "envs" / "mujoco" / "assets" / "hopper.xml"
