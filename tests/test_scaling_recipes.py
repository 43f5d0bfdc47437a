"""Recipes of docs/scaling.md: their shell is valid, and what they run are commands that exist."""

import re
import shlex
import subprocess
from pathlib import Path

import pytest
import yaml
from mjlab.registry import list_tasks

RECIPES = Path(__file__).parents[1] / "docs" / "recipes"
SKYPILOT = {"name", "num_nodes", "workdir", "resources", "file_mounts", "setup", "run"}


def scripts() -> dict[str, str]:
  """Return the shell scripts of all recipes."""
  found = {path.name: path.read_text() for path in RECIPES.glob("*.sh")}
  for path in RECIPES.glob("*.yaml"):
    recipe = yaml.safe_load(path.read_text())
    assert recipe.keys() <= SKYPILOT
    found |= {f"{path.name}: {part}": recipe[part] for part in ("setup", "run")}
  return found


@pytest.mark.parametrize("name", scripts())
def test_the_shell_of_a_recipe_is_valid(name: str) -> None:
  subprocess.run(["bash", "-n"], input=scripts()[name], text=True, check=True)


def test_recipes_train_tasks_that_exist_with_options_of_torchrun() -> None:
  from torch.distributed.run import parse_args

  lines = [line for text in scripts().values() for line in text.splitlines() if " train " in line]
  assert len(lines) == 2
  for line in lines:
    words = shlex.split(re.sub(r'"\$\w+"', "1", line))
    assert words[words.index("train") + 1] in list_tasks()
    if "torchrun" in words:
      options = parse_args(words[words.index("torchrun") + 1 :])
      assert options.no_python
      assert options.training_script == "train"


def test_skypilot_reads_its_recipe() -> None:
  """SkyPilot checks a task by its own schema; nothing is launched."""
  sky = pytest.importorskip("sky", reason="SkyPilot is not installed; uv pip install skypilot")
  task = sky.Task.from_yaml(str(RECIPES / "skypilot.yaml"))
  assert task.num_nodes == 2
  (resources,) = task.resources
  assert set(resources.accelerators.values()) == {8}
