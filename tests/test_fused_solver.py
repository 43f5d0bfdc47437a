"""The fused solver against MuJoCo C on models of all task families, in states of a rollout."""

import mujoco
import numpy as np
import pytest
import torch
from mjlab import load_task
from mjlab_envs import ManagerBasedRlEnv
from mjlab_sim.warp.solver.fused_newton import FusedNewton, refusal
from sim_problem import Problem

TASKS = (
  "Mjlab-Velocity-Flat-Unitree-Go1",
  "Mjlab-Velocity-Flat-Unitree-G1",
  "Mjlab-Tracking-Flat-Unitree-G1",
  "Mjlab-Lift-Cube-Yam",
)


def states(task: str) -> list[tuple[mujoco.MjModel, mujoco.MjData]]:
  """Return two worlds of a rollout with random actions, as MuJoCo C sees them, when constraints act in both."""
  cfg = load_task(task).env
  cfg.scene.num_envs, cfg.seed = 2, 1
  # The model of all worlds: its fields are not randomised.
  cfg.events = {name: term for name, term in cfg.events.items() if term is None or term.mode == "reset"}
  found = []
  with ManagerBasedRlEnv(cfg, device="cpu") as env:
    env.reset()
    generator = torch.Generator().manual_seed(0)
    model = env.sim.mj_model
    for step in range(100):
      env.step(torch.randn(2, env.action_manager.total_action_dim, generator=generator))
      found = [(model, host_of(env, world)) for world in range(2)]
      if step >= 11 and all(host.qfrc_constraint.any() for _, host in found):
        break
  return found


def host_of(env: ManagerBasedRlEnv, world: int) -> mujoco.MjData:
  host = mujoco.MjData(env.sim.mj_model)
  host.qpos[:], host.qvel[:] = env.sim.data.qpos[world], env.sim.data.qvel[world]
  host.ctrl[:] = env.sim.data.ctrl[world]
  mujoco.mj_forward(env.sim.mj_model, host)
  return host


@pytest.mark.warp
@pytest.mark.parametrize("task", TASKS)
def test_solutions_on_the_models_of_tasks_are_optimal_by_mujoco(task: str) -> None:
  rows = 0
  for model, host in states(task):
    # One kernel for the two.
    problem = Problem(model, host, rows=256)
    m, d = problem.m, problem.d
    assert refusal(m, d) is None
    assert d.nefc.numpy()[0] == host.nefc
    m.opt.iterations = 100
    FusedNewton(m, d).solve(m, d)
    gap, residual = problem.judge(d.qacc.numpy()[0])
    rows += host.nefc
    # In the unit of the solver's tolerance, 1e-6.
    assert abs(gap) < 2e-6, (task, gap)
    assert residual < 1e-3, (task, residual)
    difference = np.abs(d.qacc.numpy()[0] - problem.best).max() / np.abs(problem.best).max()
    assert difference < 1e-3, (task, difference)
  assert rows > 0
