"""The migration guide names what exists, and former names lead to it."""

import dataclasses
import importlib
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from mjlab._moved import MOVED
from mjlab_core import FORMER_FIELDS, Config, ConfigError
from mjlab_managers import RewardTermCfg, SceneEntityCfg
from mjlab_sensors import RayCastSensorCfg
from mjlab_sim import SimulationCfg
from mjlab_velocity.mdp import UniformVelocityCommandCfg

GUIDE = (Path(__file__).parents[1] / "docs" / "migration.md").read_text(encoding="utf-8")
MODULES = (
  *("mjlab_actuators", "mjlab_cartpole", "mjlab_envs.mdp", "mjlab_manipulation", "mjlab_motions", "mjlab_rl"),
  *("mjlab_scene", "mjlab_sensors", "mjlab_tracking.mdp", "mjlab_velocity.mdp", "mjlab_viewer"),
)


def found(name: str) -> Any:
  """Return the module, attribute or dataclass field of a dotted name."""
  parts = name.split(".")
  value: Any = importlib.import_module(parts[0])
  for number, part in enumerate(parts[1:], start=1):
    if dataclasses.is_dataclass(value) and part in {field.name for field in dataclasses.fields(value)}:
      return part
    try:
      value = getattr(value, part)
    except AttributeError:
      value = importlib.import_module(".".join(parts[: number + 1]))
  return value


@pytest.mark.parametrize("name", sorted(set(re.findall(r"`(mjlab_\w+(?:\.\w+)*)`", GUIDE))))
def test_every_name_of_this_project_in_the_guide_exists(name: str) -> None:
  assert found(name) is not None


def config_classes() -> dict[str, list[type]]:
  """Return config classes and their subclasses, by name."""
  for module in MODULES:
    importlib.import_module(module)
  by_name: dict[str, list[type]] = {}
  waiting: list[type] = [Config]
  while waiting:
    cls = waiting.pop()
    waiting += cls.__subclasses__()
    for base in cls.__mro__:
      by_name.setdefault(base.__name__, []).append(cls)
  return by_name


def test_former_fields_lead_to_fields_and_stand_in_the_guide() -> None:
  classes, section = config_classes(), GUIDE[GUIDE.index("### Fields") : GUIDE.index("## Terms")]
  rows = {tuple(re.split(r" \| ", row)) for row in re.findall(r"\| (.*) \|\n", section)[1:]}
  expected = set()
  for name, former in FORMER_FIELDS.items():
    assert name in classes, name
    names = {field.name for cls in classes[name] if dataclasses.is_dataclass(cls) for field in dataclasses.fields(cls)}
    for old, new in former.items():
      assert old not in names, f"{name}.{old} is a field"
      assert not new.isidentifier() or new in names, f"{name}.{old}: {new}"
      expected.add((f"`{name}`", f"`{old}`", f"`{new}`" if new.isidentifier() else new))
  assert rows == expected


@pytest.mark.parametrize(
  ("cls", "given", "message"),
  [
    (UniformVelocityCommandCfg, {"rel_standing_envs": 0.1}, "it is called 'standing_fraction' here"),
    (UniformVelocityCommandCfg, {"entity_name": "robot"}, "it is called 'entity' here"),
    (SimulationCfg, {"mujoco": None}, "SimulationCfg(timestep=..., iterations=...)"),
    (SceneEntityCfg, {"name": "robot", "joint_ids": [1]}, "patterns or indices as joint_names"),
    (RewardTermCfg, {"func": print, "weigth": 1.0}, "Nearest: weight"),
    (RayCastSensorCfg, {"include_geom_groups": (0,)}, "it is called 'geom_groups' here"),
  ],
)
def test_a_former_or_misspelt_field_is_answered(cls: Any, given: dict[str, Any], message: str) -> None:
  with pytest.raises(ConfigError) as caught:
    cls(**given)
  assert message in str(caught.value)


@pytest.mark.parametrize("module", ["mjlab.envs", "mjlab.managers", "mjlab.entity", "mjlab.sensor", "mjlab.tasks"])
def test_a_former_module_names_its_new_place(module: str) -> None:
  with pytest.raises(ModuleNotFoundError, match=f"{module} is now {MOVED[module]}"):
    importlib.import_module(module)


def test_a_module_within_a_former_one_is_named_too_and_others_are_just_missing() -> None:
  with pytest.raises(ModuleNotFoundError, match=r"mjlab\.envs\.mdp\.dr is now mjlab_dr"):
    importlib.import_module("mjlab.envs.mdp.dr")
  with pytest.raises(ModuleNotFoundError, match=r"^No module named 'mjlab\.nothing'$"):
    importlib.import_module("mjlab.nothing")
  assert all(f"`{old}`" in GUIDE for old in ("mjlab.envs", "mjlab.managers", "mjlab.sensor", "mjlab.terrains"))
  for new in MOVED.values():
    importlib.import_module(new)


def test_asking_for_a_former_module_imports_no_torch() -> None:
  code = "import sys\ntry:\n  import mjlab.envs\nexcept ModuleNotFoundError: pass\nassert 'torch' not in sys.modules"
  subprocess.run([sys.executable, "-c", code], check=True)
