"""Policies that ship fit their tasks and pass their own check."""

from importlib.resources import as_file

import pytest
from mjlab.demos import TASKS, shipped
from mjlab.environments import standard_env
from mjlab.registry import list_tasks, load_task
from mjlab_deploy import open_bundle
from mjlab_deploy.simulation.verification import verify
from mjlab_rl import BundlePolicy

MOST_BYTES = 12e6
"""Size of all policies that ship."""


def test_policies_that_ship_are_of_known_tasks_and_small() -> None:
  assert set(TASKS.values()) <= set(list_tasks())
  found = shipped()
  assert found
  assert sum(len(file.read_bytes()) for folder in found.values() for file in folder.iterdir()) < MOST_BYTES


@pytest.mark.parametrize("name", list(TASKS))
def test_a_shipped_bundle_is_verified_and_fits_its_task(name: str) -> None:
  folder = shipped().get(name)
  if folder is None:
    pytest.skip("it does not ship")
  with as_file(folder) as path:
    with open_bundle(path) as bundle:
      assert bundle.description.task == TASKS[name]
      report = verify(bundle)
    assert report.passed, report.failures
    parts = load_task(TASKS[name])
    cfg = parts.play(parts.env) if parts.play is not None else parts.env
    cfg.scene.num_envs = 2
    with standard_env(cfg, device="cpu") as env:
      policy = BundlePolicy(path, env)
      action = policy(env.get_observations())
    assert action.shape == (2, env.action_manager.total_action_dim)
    assert bool(action.isfinite().all())
