"""Forces and torques on bodies, against Newton's laws on a free box."""

from typing import Any

import mujoco
import numpy as np
import torch
from envs_hopper import Ended, Make, end
from envs_watch import Watch
from mjlab_envs import ManagerBasedRlEnvCfg, mdp
from mjlab_managers import EventTermCfg, SceneEntityCfg, TerminationTermCfg
from mjlab_scene import EntityCfg, SceneCfg
from mjlab_sim import SimulationCfg
from scipy.spatial.transform import Rotation

BOX_BODY = SceneEntityCfg("box", body_names=("box",))
MASS = 2.0
SPIN = 0.05  # moment of inertia [kg m^2]
BOX = f"""
<mujoco>
  <worldbody>
    <body name="box">
      <freejoint/>
      <inertial mass="{MASS}" pos="0.1 0 0" diaginertia="{SPIN} {SPIN} {SPIN}"/>
      <geom size="0.1"/>
    </body>
  </worldbody>
</mujoco>
"""


def box_cfg(engine: Any, num_envs: int = 3, **events: EventTermCfg) -> ManagerBasedRlEnvCfg:
  reset = EventTermCfg(mdp.reset_scene_to_default, mode="reset")
  return ManagerBasedRlEnvCfg(
    decimation=2,
    seed=1,
    scene=SceneCfg(num_envs=num_envs, entities={"box": EntityCfg(spec_fn=lambda: mujoco.MjSpec.from_string(BOX))}),
    sim=SimulationCfg(engine=engine, timestep=0.005, gravity=(0.0, 0.0, 0.0), num_threads=1),
    terminations={"ended": TerminationTermCfg(Ended)},
    events={"reset": reset, **events},
  )


def impulse(**params: Any) -> EventTermCfg:
  return EventTermCfg(mdp.apply_body_impulse, mode="step", params={**params, "asset": BOX_BODY})


def step(env: Any) -> None:
  env.step(torch.zeros(env.num_envs, 0, device=env.device))


def test_a_force_acts_for_the_whole_episode(make: Make, engine: str) -> None:
  ranges = {"force_range": {"x": (2.0, 6.0)}, "torque_range": (-0.01, 0.01), "asset": BOX_BODY}
  push = EventTermCfg(mdp.apply_external_force_torque, mode="reset", params=ranges)
  env = make(box_cfg(engine, push=push))
  force, torque = env.sim.data.xfrc_applied[:, 1].clone().split(3, -1)
  assert ((force[:, 0] >= 2.0) & (force[:, 0] <= 6.0)).all()
  assert not force[:, 1:].any()
  assert torch.unique(force[:, 0]).numel() == 3
  assert (torque.abs() <= 0.01).all()
  assert torque.all()
  for _ in range(5):
    step(env)
  velocity = env.scene["box"].data.root_com_lin_vel_w
  torch.testing.assert_close(velocity, force / MASS * 5 * 0.01, rtol=1e-4, atol=1e-6)
  before = env.sim.data.xfrc_applied.clone()
  end(env, 1)
  step(env)
  changed = (env.sim.data.xfrc_applied != before).flatten(1).any(1)
  assert changed.tolist() == [False, True, False]


def test_impulses_come_and_go_by_their_times(make: Make, engine: str) -> None:
  push = impulse(cooldown_s=(0.02, 0.02), duration_s=(0.03, 0.03), force_range={"y": (4.0, 4.0)})
  env = make(box_cfg(engine, push=push))
  moves = []
  speed = torch.zeros(3, dtype=env.sim.dtype, device=env.device)
  for number in range(14):
    if number == 8:
      end(env, 2)
    step(env)
    now = env.scene["box"].data.root_com_lin_vel_w[:, 1].clone()
    moves.append(((now - speed) / (4.0 / MASS * 0.01)).cpu().numpy())
    speed = now
    if number == 8:
      end(env)
  seen = np.array(moves).T
  steady = [0, 0, 1, 1, 1, 0, 0, 1, 1, 1, 0, 0, 1, 1]
  np.testing.assert_allclose(seen[:2], [steady, steady], atol=1e-3)
  # The ninth step ended in a reset, which takes the speed away and begins with a wait.
  np.testing.assert_allclose(seen[2, :8], steady[:8], atol=1e-3)
  np.testing.assert_allclose(seen[2, 9:], [0, 0, 1, 1, 1], atol=1e-3)


def test_times_differ_between_worlds_and_a_step_waits_for_nothing(make: Make) -> None:
  times: dict[str, Any] = {"cooldown_s": (0.0, 0.1), "duration_s": (0.01, 0.1)}
  push = impulse(**times, force_range=(-3.0, 3.0), body_point_offset=(0.0, 0.2, 0.0))
  env = make(box_cfg("native", num_envs=32, push=push))
  env.step(torch.zeros(32, 0))
  with Watch() as watch:
    env._step_stages()
  assert watch.waits == []
  seen = []
  for _ in range(60):
    step(env)
    wrench = env.sim.data.xfrc_applied[:, 1].double().numpy()
    force, torque = wrench[:, :3], wrench[:, 3:]
    seen.append(force.any(1))
    turned = Rotation.from_quat(env.sim.data.qpos.numpy()[:, [4, 5, 6, 3]])
    # The torque belongs to the attitude in which it was written.
    arm = turned.apply([0.0, 0.2, 0.0])
    np.testing.assert_allclose(torque, np.cross(arm, force), atol=2e-3)
    assert (np.abs(force) <= 3.0).all()
  share = np.mean(seen)
  assert 0.35 < share < 0.7
  assert len({tuple(column) for column in np.array(seen).T}) == 32
  assert set(env.drawers()) >= {"event push"}
