"""A rollout of a velocity task, with everything that an oracle needs to know about each step."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from mjlab_envs import ManagerBasedRlEnv
from mjlab_managers import MetricsTermCfg
from velocity_facts import TASKS
from velocity_oracle import SUBSTEPS, Contacts, Feet, World

FLAT_GO1 = "Mjlab-Velocity-Flat-Unitree-Go1"
_SUBSTEPS: list[tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]] = []
STATE: dict[str, np.ndarray] = {}


def note_contacts(env: ManagerBasedRlEnv) -> torch.Tensor:
  """Keep the contacts of each substep."""
  contact = env.scene["feet_ground_contact"].data
  strongest = {
    name: torch.linalg.vector_norm(sensor.data.force, dim=-1).double().numpy()
    for name, sensor in env.scene.sensors.items()
    if getattr(sensor.cfg, "history_length", 0)
  }
  _SUBSTEPS.append((contact.found.double().numpy() > 0, contact.force.double().numpy().copy(), strongest))
  return torch.zeros(env.num_envs)


def note_state(env: ManagerBasedRlEnv) -> torch.Tensor:
  """Keep the state that rewards are given for, before anybody is reset or pushed."""
  STATE.update(qpos=env.sim.data.qpos.double().numpy().copy(), qvel=env.sim.data.qvel.double().numpy().copy())
  return torch.zeros(env.num_envs)


def make_env(num_envs: int, seed: int = 7, task: str = FLAT_GO1, **changes: Any) -> ManagerBasedRlEnv:
  """A task, by default the flat one of the Go1; `changes` are attributes of its config."""
  cfg = TASKS[task].make().env
  cfg.scene.num_envs, cfg.seed = num_envs, seed
  for name, value in changes.items():
    setattr(cfg, name, value)
  return ManagerBasedRlEnv(cfg, device="cpu")


def started_env(num_envs: int, **options: Any) -> ManagerBasedRlEnv:
  """`make_env` after a reset."""
  env = make_env(num_envs, **options)
  env.reset()
  return env


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
  failed: tuple[bool, bool]
  timed_out: tuple[bool, bool]
  command: np.ndarray
  """That the reward was for."""
  before: tuple[np.ndarray, np.ndarray]
  """Position and velocity at the end of physics."""
  after: tuple[np.ndarray, np.ndarray]
  """Position and velocity when the step returns."""
  origin: np.ndarray
  """Of the world when the step returns."""
  shadow: tuple[np.ndarray, np.ndarray]
  """Position and velocity at the end of physics, by MuJoCo C."""
  contacts: list[tuple[Contacts, Contacts]]
  """By substep."""


class Rollout:
  """Steps all worlds and keeps the oracle in step. Terms of weight zero get weight one, or they would not be looked at.

  The oracle follows the environment's own states and contacts, so that its formulas are tested at any precision; what
  MuJoCo C makes of the same step from the same start is in `shadow` and `contacts`.
  """

  def __init__(
    self, task: str, num_envs: int, engine: Literal["native", "warp"] = "native", seed: int = 7, **changes: Any
  ) -> None:
    self.task = TASKS[task]
    self.robot = self.task.robot
    cfg = self.task.make().env
    cfg.scene.num_envs, cfg.seed, cfg.sim.engine = num_envs, seed, engine
    # On rough ground, all rows.
    cfg.scene.max_init_terrain_level = None
    for name, value in changes.items():
      setattr(cfg, name, value)
    for term in cfg.rewards.values():
      if term is not None and term.weight == 0.0:
        term.weight = 1.0
    cfg.metrics["contacts"] = MetricsTermCfg(note_contacts, per_substep=True)
    cfg.metrics["state"] = MetricsTermCfg(note_state)
    self.env = ManagerBasedRlEnv(cfg, device="cpu")
    self.observations, _ = self.env.reset()
    self.worlds = [World(self.env, world, self.robot) for world in range(num_envs)]
    self.feet = [Feet(len(self.robot.feet)) for _ in range(num_envs)]
    self.actions = [[np.zeros(self.num_actions), np.zeros(self.num_actions)] for _ in range(num_envs)]
    self.ages = np.zeros(num_envs, dtype=int)

  @property
  def num_actions(self) -> int:
    return len(self.robot.joints)

  def set_age(self, world: int, steps: int) -> None:
    """Make an episode older than it is."""
    self.env.episode_length_buf[world] = steps
    self.ages[world] = steps

  def terms(self, group: str) -> list[dict[str, np.ndarray]]:
    """Observations of each world by term."""
    observation: Any = self.observations[group]
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
      before = STATE["qpos"][i], STATE["qvel"][i]
      world.look(*before)
      seen = [
        Contacts(found[i], force[i], {name: values[i] for name, values in strongest.items()})
        for found, force, strongest in _SUBSTEPS
      ]
      self.feet[i].step([substep.found for substep in seen], world.heights)
      oracle = world.rewards(commands[i], self.actions[i], self.feet[i], seen)
      failed, timed_out = self._ends(world, seen)
      last = seen[-1]
      if failed or timed_out:
        count = len(self.robot.feet)
        self.feet[i], self.ages[i] = Feet(count), 0
        self.actions[i] = [np.zeros(self.num_actions), np.zeros(self.num_actions)]
        last = Contacts(np.zeros(count, dtype=bool), np.zeros((count, 3)))
      world.look(after[0][i], after[1][i])
      looked, biased = world.observe(self.actions[i][-1], now[i], self.feet[i].air_time, last)
      steps.append(
        Step(
          world=i,
          rewards={n: (v / w, oracle[n]) for n, v, w in zip(names, values[i], weights, strict=True)},
          total=(reward[i].item(), 0.02 * sum(w * oracle[n] for n, w in zip(names, weights, strict=True))),
          critic={name: (critic[i][name], value) for name, value in looked.items()},
          actor={n: (value, biased if n == "joint_pos" else looked[n]) for n, value in actor[i].items()},
          failed=(bool(terminated[i]), failed),
          timed_out=(bool(truncated[i]), timed_out),
          command=commands[i],
          before=before,
          after=(after[0][i], after[1][i]),
          origin=env.scene.env_origins[i].double().numpy().copy(),
          shadow=shadow,
          contacts=list(zip(seen, contacts, strict=True)),
        )
      )
    return steps

  def _ends(self, world: World, step: list[Contacts]) -> tuple[bool, bool]:
    """Whether the episode fails, and whether it is cut short."""
    assert len(step) == SUBSTEPS
    if self.task.rough and self.robot.touch:
      failed = any((substep.strongest["thigh_ground_touch"] > 10.0).any() for substep in step)
    else:
      failed = world.tilt > np.deg2rad(70.0)
    x, y = world.data.qpos[:2]
    outside = self.task.rough and (abs(x) > 59.7 or abs(y) > 47.7)
    # A fall in the last step is a failure.
    return bool(failed), bool((self.ages[world.index] >= 1000 or outside) and not failed)
