"""Whole episodes of the lift tasks against NumPy and MuJoCo C: what is seen, rewarded and ended, with noise."""

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from manipulation_worlds import COLOURS, three_cubes
from mjlab_envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
from mjlab_managers import MetricsTermCfg
from mjlab_manipulation import lift_cube_env
from mjlab_manipulation.mdp import LiftCommand

Env = Callable[[], ManagerBasedRlEnvCfg]

JOINTS = ("joint1", "joint2", "joint3", "joint4", "joint5", "joint6", "left_finger", "right_finger")
HOME = np.array([0.0, 1.047, 1.05, -0.9, 0.0, 0.0, 0.01875, -0.01875])
SCALE = np.array([0.359942655446, 0.159791853409, 0.190442715750, 0.525019398588, 1.5708, 2.0944, 0.019787])
NOISE = {"joint_pos": 0.01, "joint_vel": 1.5, "ee_to_cube": 0.01, "cube_to_goal": 0.01}
WEIGHTS = {
  "lift": 1.0,
  "lift_precise": 1.0,
  "action_rate_l2": -0.01,
  "joint_pos_limits": -10.0,
  "joint_vel_hinge": -0.01,
}
STEP, SUBSTEPS = 0.02, 4
_STATE: dict[str, np.ndarray] = {}


def note_state(env: ManagerBasedRlEnv) -> torch.Tensor:
  """Keep what rewards are given for, before anybody is reset."""
  term = command(env)
  values = {"qpos": env.sim.data.qpos, "qvel": env.sim.data.qvel, "goal": term.goal_pos_w, "target": term.target}
  _STATE.update({name: value.numpy().copy() for name, value in values.items()}, time=term.goal_time.numpy().copy())
  return torch.zeros(env.num_envs)


def command(env: ManagerBasedRlEnv) -> LiftCommand:
  term: Any = env.command_manager.get_term("lift_height")
  return term


class World:
  """One world in MuJoCo C."""

  def __init__(self, env: ManagerBasedRlEnv, world: int, objects: tuple[str, ...]) -> None:
    self.model = model = copy.copy(env.sim.mj_model)
    model.geom_friction[:] = env.sim.model.geom_friction[world].numpy()
    self.data = mujoco.MjData(model)
    self.data.mocap_pos[:] = env.sim.data.mocap_pos[world].numpy()
    self.data.mocap_quat[:] = env.sim.data.mocap_quat[world].numpy()
    self._objects = [model.body(f"{name}/cube").id for name in objects]
    self._site, self._root = model.site("robot/grasp_site").id, model.body("robot/mocap_base").id
    joints = [model.joint(f"robot/{name}") for name in JOINTS]
    self._q, self._v = [int(j.qposadr[0]) for j in joints], [int(j.dofadr[0]) for j in joints]
    self._range = np.array([j.range for j in joints])
    self._driven = [JOINTS.index(model.joint(int(j)).name.removeprefix("robot/")) for j in model.actuator_trnid[:, 0]]
    bodies = [int(body) for body in model.geom_bodyid]
    self._ground = {g for g, body in enumerate(bodies) if model.body(body).name == "terrain"}
    self._hand = {g for g, body in enumerate(bodies) if self._is_in_hand(body)}

  def _is_in_hand(self, body: int) -> bool:
    while body:
      if self.model.body(body).name == "robot/link_6":
        return True
      body = int(self.model.body_parentid[body])
    return False

  def simulate(self, qpos: np.ndarray, qvel: np.ndarray, warmstart: np.ndarray, action: np.ndarray) -> float:
    """One environment step; the strongest contact of the hand with the ground in any substep [N]."""
    data = self.data
    data.qpos[:], data.qvel[:], data.qacc_warmstart[:] = qpos, qvel, warmstart
    wanted = np.clip(HOME[:7] + SCALE * action, self._range[:7, 0], self._range[:7, 1])
    data.ctrl[:] = wanted[self._driven]
    strongest, force = 0.0, np.zeros(6)
    for _ in range(SUBSTEPS):
      mujoco.mj_step(self.model, data)
      for index, pair in enumerate(data.contact.geom.tolist()):
        if not self._ground.isdisjoint(pair) and not self._hand.isdisjoint(pair):
          mujoco.mj_contactForce(self.model, data, index, force)
          strongest = max(strongest, float(np.linalg.norm(force[:3])))
    return strongest

  def look(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
    self.data.qpos[:], self.data.qvel[:] = qpos, qvel
    mujoco.mj_forward(self.model, self.data)

  def rewards(self, target: int, goal: np.ndarray, actions: list[np.ndarray]) -> dict[str, float]:
    cube, hand = self.data.xpos[self._objects[target]], self.data.site_xpos[self._site]
    to_hand, to_goal = np.sum((cube - hand) ** 2), np.sum((goal - cube) ** 2)
    q, v = self.data.qpos[self._q], self.data.qvel[self._v]
    middle, half = self._range.mean(1), 0.9 * 0.5 * np.ptp(self._range, axis=1)
    return {
      "lift": float(np.exp(-to_hand / 0.2**2) * (1.0 + np.exp(-to_goal / 0.3**2))),
      "lift_precise": float(np.exp(-to_goal / 0.05**2)),
      "action_rate_l2": float(np.sum((actions[-1] - actions[-2]) ** 2)),
      "joint_pos_limits": float(np.maximum(np.abs(q - middle) - half, 0.0).sum()),
      "joint_vel_hinge": float((np.maximum(np.abs(v[:6]) - 0.5, 0.0) ** 2).sum()),
    }

  def observe(self, target: int, goal: np.ndarray, action: np.ndarray) -> dict[str, np.ndarray]:
    axes = self.data.xmat[self._root].reshape(3, 3).T
    cube, hand = self.data.xpos[self._objects[target]], self.data.site_xpos[self._site]
    return {
      "joint_pos": self.data.qpos[self._q] - HOME,
      "joint_vel": self.data.qvel[self._v].copy(),
      "ee_to_cube": axes @ (cube - hand),
      "cube_to_goal": axes @ (goal - cube),
      "actions": action,
    }


@dataclass(kw_only=True)
class Step:
  """One step of one world: what the environment said, and what the oracle says."""

  rewards: dict[str, tuple[float, float]]
  total: tuple[float, float]
  critic: dict[str, tuple[np.ndarray, np.ndarray]]
  actor: dict[str, tuple[np.ndarray, np.ndarray]]
  failed: tuple[bool, bool]
  truncated: tuple[bool, bool]
  shadow: tuple[np.ndarray, np.ndarray]


@pytest.fixture(scope="module", params=[(lift_cube_env, ("cube",)), (three_cubes, COLOURS)], ids=["one", "three"])
def steps(request: pytest.FixtureRequest) -> list[Step]:
  make, objects = request.param
  num_envs = 8
  cfg = make()
  cfg.scene.num_envs, cfg.seed = num_envs, 4
  cfg.metrics["state"] = MetricsTermCfg(note_state)
  goals: Any = cfg.commands["lift_height"]
  goals.goal_time_range = (0.4, 1.0)
  env = ManagerBasedRlEnv(cfg, device="cpu")
  env.reset()
  worlds = [World(env, world, objects) for world in range(num_envs)]
  actions = [[np.zeros(7), np.zeros(7)] for _ in worlds]
  ages = np.zeros(num_envs, dtype=int)
  generator = torch.Generator().manual_seed(2)
  loudness = torch.tensor([0.1, 0.5, 2.0, 6.0]).repeat(2)[:, None]
  action = torch.zeros(num_envs, 7)
  seen: list[Step] = []
  for k in range(150):
    if k % 5 == 0:
      action = torch.randn(num_envs, 7, generator=generator) * loudness
      # Two reach down all the while, and two bend as far as they can.
      action[[3, 7], 1:3] = torch.tensor([8.0, -2.0])
      action[[2, 6], 3:5] = 9.0
    data, term = env.sim.data, command(env)
    qpos, qvel, warmstart = (v.numpy().copy() for v in (data.qpos, data.qvel, data.qacc_warmstart))
    observations, reward, terminated, truncated, _ = env.step(action)
    ages += 1
    values = env.reward_manager.step_reward.double().numpy()
    after = data.qpos.numpy().copy(), data.qvel.numpy().copy()
    rows = {}
    for group in ("actor", "critic"):
      table: Any = observations[group]
      rows[group] = table.double().numpy()
    layout = {term.name: term.columns for term in env.observation_manager.layout("critic")}
    for w, world in enumerate(worlds):
      actions[w].append(action[w].double().numpy())
      force = world.simulate(qpos[w], qvel[w], warmstart[w], actions[w][-1])
      shadow = world.data.qpos.copy()
      world.look(_STATE["qpos"][w], _STATE["qvel"][w])
      expected = world.rewards(int(_STATE["target"][w]), _STATE["goal"][w], actions[w])
      failed, over = force > 10.0, bool(ages[w] * STEP >= _STATE["time"][w] - 1e-6)
      if failed or over:
        actions[w], ages[w] = [np.zeros(7), np.zeros(7)], 0
      world.look(after[0][w], after[1][w])
      looked = world.observe(int(term.target[w]), term.goal_pos_w[w].numpy(), actions[w][-1])
      names = list(env.reward_manager.active_terms)
      seen.append(
        Step(
          rewards={n: (v / WEIGHTS[n], expected[n]) for n, v in zip(names, values[w], strict=True)},
          total=(reward[w].item(), STEP * sum(WEIGHTS[n] * expected[n] for n in names)),
          critic={name: (rows["critic"][w][layout[name]], value) for name, value in looked.items()},
          actor={name: (rows["actor"][w][layout[name]], value) for name, value in looked.items()},
          failed=(bool(terminated[w]), failed),
          truncated=(bool(truncated[w]), over),
          shadow=(_STATE["qpos"][w].copy(), shadow),
        )
      )
  env.close()
  return seen


def sides(steps: list[Step], kind: str, name: str) -> tuple[np.ndarray, np.ndarray]:
  return np.array([getattr(s, kind)[name][0] for s in steps]), np.array([getattr(s, kind)[name][1] for s in steps])


def test_every_reward_is_its_formula_and_the_total_their_weighted_sum(steps: list[Step]) -> None:
  for name in WEIGHTS:
    ours, oracle = sides(steps, "rewards", name)
    np.testing.assert_allclose(ours, oracle, rtol=1e-5, atol=1e-6, err_msg=name)
    # A cube that is not lifted is hardly ever near its goal.
    assert oracle.max() > (1e-12 if name == "lift_precise" else 1e-3), name
  ours, oracle = np.array([s.total for s in steps]).T
  np.testing.assert_allclose(ours, oracle, rtol=1e-5, atol=1e-6)


def test_the_critic_sees_every_quantity_and_the_actor_with_uniform_noise(steps: list[Step]) -> None:
  for name in steps[0].critic:
    ours, oracle = sides(steps, "critic", name)
    np.testing.assert_allclose(ours, oracle, rtol=1e-5, atol=2e-6, err_msg=name)
    noisy, clean = sides(steps, "actor", name)
    if name not in NOISE:
      np.testing.assert_array_equal(noisy, ours)
      continue
    noise = (noisy - clean) / NOISE[name]
    assert 0.99 < np.abs(noise).max() < 1.0 + 1e-5 / NOISE[name], name
    spread = 1.0 / np.sqrt(3.0)
    assert abs(noise.mean()) < 5.0 * spread / np.sqrt(noise.size), name
    assert abs(noise.std() - spread) < 2.5 * spread / np.sqrt(noise.size), name


def test_episodes_end_with_their_goal_or_where_the_hand_presses_on_the_ground(steps: list[Step]) -> None:
  assert [s.failed[0] for s in steps] == [s.failed[1] for s in steps]
  assert [s.truncated[0] for s in steps] == [s.truncated[1] for s in steps]
  assert sum(s.failed[1] for s in steps) > 2
  assert sum(s.truncated[1] for s in steps) > 10


def test_physics_is_that_of_mujoco_c_under_targets_within_their_range(steps: list[Step]) -> None:
  ours, oracle = np.array([s.shadow[0] for s in steps]), np.array([s.shadow[1] for s in steps])
  np.testing.assert_allclose(ours, oracle, rtol=0.0, atol=1e-7)
