"""Layers of the workspace: floors, declared requirements, no circles, and private names in one module per library."""

import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Any

import measure_source
import pytest

ROOT = Path(__file__).parents[1]

PROJECTS = sorted([*ROOT.glob("packages/*/pyproject.toml"), *ROOT.glob("tasks/*/pyproject.toml")])
MEMBERS = {path.parent.name: path.parent for path in PROJECTS}
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
DISTRIBUTION_OF = packages_distributions()


def module_of(member: str) -> str:
  return "mjlab" if member == "mjlab" else f"mjlab_{member}"


@cache
def project(member: str) -> dict:
  return tomllib.loads((MEMBERS[member] / "pyproject.toml").read_text(encoding="utf-8"))


def names(requirements: list[str]) -> set[str]:
  """Return normalised names of distributions of requirements."""
  return {re.split(r"[^A-Za-z0-9._-]", requirement)[0].lower().replace("_", "-") for requirement in requirements}


def required(member: str) -> set[str]:
  return names(project(member)["project"]["dependencies"])


def installed_with(member: str) -> set[str]:
  """Return the requirements of a member, and those of the members among them."""
  found = required(member)
  for other in MEMBERS:
    if other != member and module_of(other).replace("_", "-") in found:
      found |= installed_with(other)
  return found


def imports(folder: Path) -> Iterator[tuple[str, str]]:
  """Yield (place, top-level module) of every import statement below a folder."""
  of_source = {module.path: module for member in measure_source.members() for module in member.modules}
  for path in sorted(folder.rglob("*.py")):
    for line, name, _ in measure_source.imported(of_source.get(path, measure_source.Module("", path))):
      top = name.partition(".")[0]
      if top not in sys.stdlib_module_names:
        yield f"{path.relative_to(ROOT)}:{line}", top


def undeclared(folder: Path, declared: set[str], own: set[str]) -> list[str]:
  found = []
  for where, module in imports(folder):
    distributions = {name.lower().replace("_", "-") for name in DISTRIBUTION_OF.get(module, [module])}
    if module not in own and not distributions & declared:
      found.append(f"{where}: {module}")
  return found


def test_import_contracts_hold() -> None:
  lint = "from importlinter.cli import lint_imports_command; lint_imports_command()"
  run = subprocess.run([sys.executable, "-c", lint, "--no-cache"], cwd=ROOT, capture_output=True, text=True)
  assert run.returncode == 0, run.stdout + run.stderr
  assert "0 broken" in run.stdout


@pytest.mark.parametrize("member", MEMBERS)
def test_every_member_stands_under_the_contracts(member: str) -> None:
  linter = SETTINGS["tool"]["importlinter"]
  module = module_of(member)
  assert module in linter["root_packages"]
  floors = next(contract for contract in linter["contracts"] if contract["id"] == "floors")["layers"]
  assert module in [room.strip() for floor in floors for room in floor.split("|")]
  sources = [contract["source_modules"] for contract in linter["contracts"] if contract["type"] == "forbidden"]
  assert [module] in sources or member == "mjlab", f"name what {member} may not import"


@pytest.mark.parametrize("member", MEMBERS)
def test_source_imports_only_declared_requirements(member: str) -> None:
  optional = project(member)["project"].get("optional-dependencies", {})
  declared = required(member).union(*(names(extra) for extra in optional.values()))
  missing = undeclared(MEMBERS[member] / "src", declared, {module_of(member)})
  assert not missing, "\n".join(missing)


@pytest.mark.parametrize("member", MEMBERS)
def test_tests_import_only_installed_requirements(member: str) -> None:
  folder = MEMBERS[member] / "tests"
  own = {module_of(member), *(path.stem for path in folder.glob("*.py"))}
  extra = names(project(member).get("dependency-groups", {}).get("test", []))
  missing = undeclared(folder, installed_with(member) | extra | {"pytest"}, own)
  assert not missing, "\n".join(missing)


def test_one_sync_installs_the_requirements_of_all_tests() -> None:
  dev = names(SETTINGS["dependency-groups"]["dev"])
  for member in MEMBERS:
    assert names(project(member).get("dependency-groups", {}).get("test", [])) <= dev | installed_with("mjlab"), member


def test_the_lock_has_the_requirements_of_every_member() -> None:
  locked = {package["name"]: package for package in tomllib.loads((ROOT / "uv.lock").read_text("utf-8"))["package"]}
  for member in MEMBERS:
    metadata = locked[project(member)["project"]["name"]]["metadata"]
    entries = [entry for entry in metadata["requires-dist"] if "extra ==" not in entry.get("marker", "")]
    assert {entry["name"] for entry in entries} == required(member), f"{member}: run `uv lock`"
    declared = {group: names(extra) for group, extra in project(member).get("dependency-groups", {}).items()}
    found = {group: {entry["name"] for entry in extra} for group, extra in metadata.get("requires-dev", {}).items()}
    assert found == declared, f"{member}: run `uv lock`"


@pytest.mark.parametrize("member", measure_source.members(), ids=lambda member: member.name)
def test_modules_of_a_member_do_not_import_each_other_in_a_circle(member: Any) -> None:
  circles = measure_source.import_circles(member)
  assert not circles


@pytest.mark.parametrize("member", measure_source.members(), ids=lambda member: member.name)
def test_private_names_are_used_in_one_module_per_library(member: Any) -> None:
  stray = measure_source.stray_private_names(member)
  assert not stray, "\n".join(stray)


def test_one_module_imports_matplotlib() -> None:
  modules = [module for member in measure_source.members() for module in member.modules]
  users = [m.name for m in modules if any(name.startswith("matplotlib") for _, name, _ in measure_source.imported(m))]
  assert users == ["mjlab_core.io.figures"]


def test_there_are_few_exception_classes_and_protocols() -> None:
  modules = [module for member in measure_source.members() for module in member.modules]
  errors = [name for module in modules for name in measure_source.exception_classes(module)]
  protocols = [name for module in modules for name in measure_source.protocols(module)]
  assert len(errors) <= 8, errors
  assert len(protocols) <= 12, protocols


def test_the_measure_finds_circles_of_type_hints_and_private_names(tmp_path: Path) -> None:
  folder = tmp_path / "src" / "mjlab_x"
  folder.mkdir(parents=True)
  (folder / "__init__.py").write_text("")
  (folder / "a.py").write_text(
    "from mjlab_x import b\nimport torch\ntorch._C.f()\nclass C:\n  def f(self, x):\n    self._version = x._version\n"
  )
  (folder / "b.py").write_text("def f():\n  from mjlab_x.c import _hidden\n  import_module('triton._C.libtriton')\n")
  (folder / "c.py").write_text(
    "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n  from mjlab_x.a import A\n_hidden = 1\n"
  )
  member = measure_source.Member("x", tmp_path)
  assert measure_source.import_circles(member) == [["mjlab_x.a", "mjlab_x.b", "mjlab_x.c"]]
  found = {name for _, _, _, name in measure_source.private_names(member)}
  assert found == {"torch._C", "x._version", "mjlab_x.c._hidden", "triton._C.libtriton"}
