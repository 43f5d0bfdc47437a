"""The program of docs/own_robot.md trains, plays and is evaluated."""

import importlib
import re
import shutil
import sys
from collections.abc import Generator
from pathlib import Path
from types import ModuleType

import mjlab
import pytest
from mjlab import registry
from mjlab.cli import main

ROOT = Path(__file__).parents[1]
TINY = ["--device", "cpu", "--quiet"]


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Generator[ModuleType]:
  """The page as a module that manifests of runs can name."""
  folder = tmp_path_factory.mktemp("program")
  blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "own_robot.md").read_text(encoding="utf-8"), re.DOTALL)
  (folder / "own_robot.py").write_text("\n".join(blocks), encoding="utf-8")
  shutil.copy(ROOT / "tests" / "models" / "quadruped.xml", folder)
  with pytest.MonkeyPatch.context() as patched:
    patched.setattr(registry, "_registered", {})
    patched.chdir(folder)
    patched.syspath_prepend(str(folder))
    yield importlib.import_module("own_robot")
  sys.modules.pop("own_robot")


@pytest.mark.parametrize("name", ["walk", "walk_rough", "wave", "lift"])
def test_a_new_robot_trains_in_every_family(program: ModuleType, name: str) -> None:
  mjlab.register_task(f"Own-{name}", getattr(program, name))
  words = ["--env.scene.num-envs", "4", "--agent.num-steps-per-env", "4", "--agent.max-iterations", "2"]
  if name == "walk_rough":
    words += ["--env.scene.terrain.rows", "2", "--env.scene.max-init-terrain-level", "1"]
  assert main(["train", f"Own-{name}", *TINY, *words, "--agent.logger", "none"]) == 0
  if name == "wave":
    assert main(["evaluate", f"Own-{name}", *TINY, "--eval.repeats", "2"]) == 0


def test_the_quadruped_stands_in_its_default_pose(program: ModuleType) -> None:
  task = program.walk()
  task.env.scene.num_envs = 2
  task.env.events["push_robot"] = None
  with mjlab.ManagerBasedRlEnv(task.play(task.env), device="cpu") as env:
    env.reset(seed=0)
    for _ in range(50):
      _, _, terminated, _, _ = env.step(env.action_manager.action * 0.0)
      assert not terminated.any()
    assert (env.scene["robot"].data.root_link_pos_w[:, 2] > 0.2).all()
