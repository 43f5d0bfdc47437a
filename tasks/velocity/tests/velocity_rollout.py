"""A rollout of the flat Go1 task, with everything that an oracle needs to know about each step."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from mjlab_envs import ManagerBasedRlEnv
from mjlab_managers import MetricsTermCfg
from mjlab_velocity import go1_flat
from velocity_oracle import Feet, World

_SUBSTEPS: list[tuple[np.ndarray, np.ndarray]] = []
_STATE: dict[str, np.ndarray] = {}


def note_contacts(env: ManagerBasedRlEnv) -> torch.Tensor:
  """Keep the contacts of each substep."""
  contact = env.scene["feet_ground_contact"].data
  _SUBSTEPS.append((contact.found.double().numpy() > 0, contact.force.double().numpy().copy()))
  return torch.zeros(env.num_envs)


def note_state(env: ManagerBasedRlEnv) -> torch.Tensor:
  """Keep the state that rewards are given for, before anybody is reset or pushed."""
  _STATE.update(qpos=env.sim.data.qpos.double().numpy().copy(), qvel=env.sim.data.qvel.double().numpy().copy())
  return torch.zeros(env.num_envs)


def make_env(num_envs: int, seed: int = 7, **changes: Any) -> ManagerBasedRlEnv:
  """The flat task; `changes` are attributes of its config."""
  cfg = go1_flat().env
  cfg.scene.num_envs, cfg.seed = num_envs, seed
  for name, value in changes.items():
    setattr(cfg, name, value)
  return ManagerBasedRlEnv(cfg, device="cpu")


@dataclass(kw_only=True)
class Step:
  """One step of one world: what the environment said, and what the oracle says."""

  world: int
  rewards: dict[str, tuple[float, float]]
  """By term, unweighted: (environment, oracle)."""
  total: tuple[float, float]
  """Reward of the step."""
  critic: dict[str, tuple[np.ndarray, np.ndarray]]
  actor: dict[str, tuple[np.ndarray, np.ndarray]]
  """Here the oracle's values have no noise."""
  fell: tuple[bool, bool]
  timed_out: tuple[bool, bool]
  tilt: float
  command: np.ndarray
  """That the reward was for."""
  before: tuple[np.ndarray, np.ndarray]
  """Position and velocity at the end of physics."""
  after: tuple[np.ndarray, np.ndarray]
  """Position and velocity when the step returns."""
  shadow: tuple[np.ndarray, np.ndarray]
  """Position and velocity at the end of physics, by MuJoCo C."""
  found: list[tuple[np.ndarray, np.ndarray]]
  """Contacts of the feet by substep."""
  force: list[tuple[np.ndarray, np.ndarray]]
  """Forces of the feet on the ground by substep [N]."""


class Rollout:
  """Steps all worlds and keeps the oracle in step. Terms of weight zero get weight one, or they would not be looked at.

  The oracle follows the environment's own states and contacts, so that its formulas are tested at any precision; what
  MuJoCo C makes of the same step from the same start is in `shadow`, `found` and `force`.
  """

  def __init__(self, num_envs: int, engine: Literal["native", "warp"] = "native", seed: int = 7) -> None:
    cfg = go1_flat().env
    cfg.scene.num_envs, cfg.seed, cfg.sim.engine = num_envs, seed, engine
    for term in cfg.rewards.values():
      if term is not None and term.weight == 0.0:
        term.weight = 1.0
    cfg.metrics["contacts"] = MetricsTermCfg(note_contacts, per_substep=True)
    cfg.metrics["state"] = MetricsTermCfg(note_state)
    self.env = ManagerBasedRlEnv(cfg, device="cpu")
    self.observations, _ = self.env.reset()
    self.worlds = [World(self.env, world) for world in range(num_envs)]
    self.feet = [Feet() for _ in range(num_envs)]
    self.actions = [[np.zeros(12), np.zeros(12)] for _ in range(num_envs)]
    self.ages = np.zeros(num_envs, dtype=int)

  def set_age(self, world: int, steps: int) -> None:
    """Make an episode older than it is."""
    self.env.episode_length_buf[world] = steps
    self.ages[world] = steps

  def terms(self, group: str) -> list[dict[str, np.ndarray]]:
    """Observations of each world by term."""
    observation = self.observations[group]
    assert isinstance(observation, torch.Tensor)
    layout = self.env.observation_manager.layout(group)
    return [{term.name: row[term.columns] for term in layout} for row in observation.double().numpy()]

  def step(self, action: torch.Tensor) -> list[Step]:
    """One step of all worlds."""
    env, data = self.env, self.env.sim.data
    qpos, qvel = data.qpos.double().numpy().copy(), data.qvel.double().numpy().copy()
    warmstart = data.qacc_warmstart.double().numpy().copy()
    commands = [terms["command"] for terms in self.terms("critic")]
    _SUBSTEPS.clear()
    self.observations, reward, terminated, truncated, _ = env.step(action)
    self.ages += 1
    names = list(env.reward_manager.active_terms)
    weights = [env.reward_manager.get_term_cfg(name).weight for name in names]
    values = env.reward_manager.step_reward.double().numpy()
    critic, actor = self.terms("critic"), self.terms("actor")
    now = [terms["command"] for terms in critic]
    after = data.qpos.double().numpy().copy(), data.qvel.double().numpy().copy()
    steps = []
    for i, world in enumerate(self.worlds):
      raw = action[i].double().numpy()
      self.actions[i].append(raw)
      contacts = world.simulate(qpos[i], qvel[i], warmstart[i], raw)
      shadow = world.data.qpos.copy(), world.data.qvel.copy()
      before = _STATE["qpos"][i], _STATE["qvel"][i]
      world.look(*before)
      self.feet[i].step([found[i] for found, _ in _SUBSTEPS], world.heights)
      found, force = (array[i] for array in _SUBSTEPS[-1])
      oracle = world.rewards(commands[i], self.actions[i], self.feet[i], found, force)
      tilt = world.tilt
      fell, timed_out = tilt > np.deg2rad(70.0), self.ages[i] >= 1000
      if fell or timed_out:
        self.feet[i], self.ages[i], self.actions[i] = Feet(), 0, [np.zeros(12), np.zeros(12)]
        found, force = np.zeros(4, dtype=bool), np.zeros((4, 3))
      world.look(after[0][i], after[1][i])
      seen, biased = world.observe(self.actions[i][-1], now[i], self.feet[i].air_time, found, force)
      steps.append(
        Step(
          world=i,
          rewards={n: (v / w, oracle[n]) for n, v, w in zip(names, values[i], weights, strict=True)},
          total=(reward[i].item(), 0.02 * sum(w * oracle[n] for n, w in zip(names, weights, strict=True))),
          critic={name: (critic[i][name], value) for name, value in seen.items()},
          actor={n: (value, biased if n == "joint_pos" else seen[n]) for n, value in actor[i].items()},
          fell=(bool(terminated[i]), bool(fell)),
          timed_out=(bool(truncated[i]), bool(timed_out)),
          tilt=tilt,
          command=commands[i],
          before=before,
          after=(after[0][i], after[1][i]),
          shadow=shadow,
          found=[(seen[0][i], c[0]) for seen, c in zip(_SUBSTEPS, contacts, strict=True)],
          force=[(seen[1][i], c[1]) for seen, c in zip(_SUBSTEPS, contacts, strict=True)],
        )
      )
    return steps
