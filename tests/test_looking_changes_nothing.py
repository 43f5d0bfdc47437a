"""Watching an environment leaves it as it is."""

import contextlib
from collections.abc import Callable
from pathlib import Path

import mjlab
import mujoco
import numpy as np
import pytest
import torch
from mjlab.environments import make
from mjlab_core import RenderingError
from mjlab_envs import ManagerBasedRlEnv
from mjlab_viewer import BrowserViewer, SnapshotTaker, TrainingVideo
from torch.utils._python_dispatch import TorchDispatchMode

TASK = "Mjlab-Velocity-Flat-Unitree-Go1"


def seeded_env() -> ManagerBasedRlEnv:
  cfg = mjlab.load_task(TASK).env
  cfg.seed, cfg.scene.num_envs = 0, 6
  env = ManagerBasedRlEnv(cfg, device="cpu")
  env.reset()
  return env


def rollout(env: ManagerBasedRlEnv, steps: int, look: Callable[[], None] = lambda: None) -> list[torch.Tensor]:
  generator = torch.Generator().manual_seed(3)
  seen: list[torch.Tensor] = []
  for _ in range(steps):
    look()
    action = torch.randn(env.num_envs, env.action_manager.total_action_dim, generator=generator)
    observations, reward, terminated, _, _ = env.step(action)
    seen += [value for value in observations.values() if isinstance(value, torch.Tensor)] + [reward, terminated]
  return [*seen, *(value for _, value in sorted(env.sim.state_dict()["data"].items()))]


def packed(model: mujoco.MjModel) -> np.ndarray:
  buffer = np.zeros(mujoco.mj_sizeModel(model), dtype=np.uint8)
  mujoco.mj_saveModel(model, None, buffer)
  return buffer


class Watchers:
  """All kinds of watching: snapshots, a page, a film and pictures."""

  def __init__(self, env: ManagerBasedRlEnv, folder: Path) -> None:
    self.env = env
    self.taker = SnapshotTaker(env, contacts=True)
    self.page = BrowserViewer(env, port=8500, video_folder=folder)
    self.page.scene.scene.show_contact_forces = True
    self.film = TrainingVideo(env, folder, interval=10, length=3)
    env.render_mode = "rgb_array"
    self._looks = 0

  def look(self) -> None:
    names = tuple(self.env.drawers())
    self.page.scene.show(self.taker.take((4, 1), drawers=names))
    self.film.after_step()
    self._looks += 1
    if self._looks % 5 == 0:
      with contextlib.suppress(RenderingError):
        self.env.render()

  def close(self) -> None:
    self.page.close()
    self.film.close()


def test_a_watched_rollout_is_the_unwatched_one_bit_for_bit(tmp_path: Path) -> None:
  with seeded_env() as env:
    alone = rollout(env, 12)
  with seeded_env() as env:
    before = packed(env.sim.mj_model)
    watchers = Watchers(env, tmp_path)
    watched = rollout(env, 12, watchers.look)
    watchers.close()
    np.testing.assert_array_equal(packed(env.sim.mj_model), before)
  assert all(torch.equal(a, b) for a, b in zip(alone, watched, strict=True))


class CountElements(TorchDispatchMode):
  """Counts the elements of all new tensors that operations make; views are not new."""

  def __init__(self) -> None:
    super().__init__()
    self.made = 0

  def __torch_dispatch__(self, func, types, args=(), kwargs=None):
    result = func(*args, **(kwargs or {}))
    if isinstance(result, torch.Tensor) and not any(r.alias_info for r in func._schema.returns):
      self.made += result.numel()
    return result


def test_the_cost_of_a_picture_depends_on_the_number_of_shown_worlds_alone() -> None:
  made = []
  for worlds in (8, 64):
    with make(TASK, num_envs=worlds, device="cpu") as env:
      env.reset(seed=0)
      taker = SnapshotTaker(env)
      taker.take((0, 1, 2), drawers=env.default_drawers())
      with CountElements() as count:
        taker.take((0, 1, 2), drawers=env.default_drawers())
      made.append(count.made)
  assert made[0] == made[1] > 0


def test_a_snapshot_holds_the_chosen_worlds_and_the_numbers_of_the_first() -> None:
  with make(TASK, num_envs=6, device="cpu") as env:
    env.reset(seed=0)
    rollout(env, 3)
    snapshot = SnapshotTaker(env).take((4, 1), drawers=tuple(env.drawers()), step=3)
    np.testing.assert_array_equal(snapshot.data["qpos"], env.sim.data.qpos[[4, 1]].numpy())
    assert set(snapshot.model) == set(env.sim.expanded_fields) != set()
    np.testing.assert_array_equal(snapshot.model["geom_friction"], env.sim.model["geom_friction"][[4, 1]].numpy())
    for group, (names, values) in env.signals().items():
      assert len(names) == values.shape[1] == len(set(names))
      np.testing.assert_array_equal(snapshot.signals[group], values[4].numpy())
    assert {"rewards", "terminations", "command twist", "observations actor"} <= set(snapshot.signals)


def test_the_contacts_of_a_snapshot_are_those_that_rewards_saw() -> None:
  with make(TASK, num_envs=6, device="cpu") as env:
    env.reset(seed=0)
    taker, sensor, model = SnapshotTaker(env, contacts=True), env.scene["feet_ground_contact"], env.sim.mj_model
    assert sensor.cfg.reduce == "netforce"
    feet = [model.geom(name).id for name in sensor.primary_names]
    rollout(env, 12)
    seen = 0.0
    for row, world in enumerate(worlds := (4, 1, 0)):
      contacts = taker.take(worlds, apart=True).contacts[row]
      for number, foot in enumerate(feet):
        on_ground = [contacts.force[contacts.geom[:, side] == foot].sum(axis=0) for side in (0, 1)]
        # The force of the foot on the ground: contacts with the foot as first geom count positive, as second negative.
        np.testing.assert_allclose(
          on_ground[0] - on_ground[1], sensor.data.force[world, number].numpy(), rtol=1e-9, atol=1e-9
        )
        seen += float(np.linalg.norm(on_ground))
    assert seen > 50.0


def test_the_command_is_drawn_as_it_is_and_where_the_robot_is() -> None:
  with make(TASK, num_envs=3, device="cpu") as env:
    env.reset(seed=0)
    env.steering()["twist"].steer(1, (1.0, 0.0, 0.0))
    rollout(env, 1)
    snapshot = SnapshotTaker(env).take((1,), drawers=("command twist",))
    wanted, actual = snapshot.drawings[0].shapes
    data = env.scene["robot"].data
    np.testing.assert_allclose(wanted.position[0, :2], data.root_link_pos_w[1, :2])
    forward = data.root_link_quat_w[1]
    heading = torch.atan2(2 * (forward[0] * forward[3] + forward[1] * forward[2]), 1 - 2 * forward[2:].square().sum())
    np.testing.assert_allclose(
      wanted.direction[0], np.array([0.4 * heading.cos(), 0.4 * heading.sin(), 0.0]), atol=1e-6
    )
    np.testing.assert_allclose(actual.direction[0, :2], 0.4 * data.root_link_lin_vel_w[1, :2], atol=1e-6)


def test_another_render_mode_is_refused_by_name() -> None:
  cfg = mjlab.load_task("Mjlab-Cartpole-Balance").env
  with pytest.raises(ValueError, match="render_mode 'human' does not exist"):
    ManagerBasedRlEnv(cfg, "cpu", render_mode="human")
