"""The common layout of members, and a repository without traces of a machine."""

import ast
import re
import subprocess
import tomllib
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MEMBERS = sorted(
  path.parent for path in [*ROOT.glob("packages/*/pyproject.toml"), *ROOT.glob("tasks/*/pyproject.toml")]
)
each_member = pytest.mark.parametrize("member", MEMBERS, ids=lambda member: member.name)


def module_folder(member: Path) -> Path:
  return member / "src" / ("mjlab" if member.name == "mjlab" else f"mjlab_{member.name}")


def project_of(member: Path) -> dict:
  return tomllib.loads((member / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def tracked_files() -> list[Path]:
  """Return the present files under version control."""
  listed = subprocess.run(
    ["git", "-c", f"safe.directory={ROOT}", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True
  ).stdout
  return [ROOT / name for name in listed.split("\0") if name and (ROOT / name).is_file()]


def text_of(path: Path) -> str:
  """Return the contents of a text file, and nothing for a binary one."""
  data = path.read_bytes()
  return "" if b"\0" in data else data.decode("utf-8")


def python_blocks(readme: Path) -> list[str]:
  return re.findall(r"```python\n(.*?)```", readme.read_text(encoding="utf-8"), re.DOTALL)


@each_member
def test_member_has_a_readme_types_and_tests(member: Path) -> None:
  assert (module_folder(member) / "py.typed").is_file()
  assert (member / "README.md").is_file()
  assert list((member / "tests").glob("test_*.py"))


@each_member
def test_member_declares_name_version_licence_and_description(member: Path) -> None:
  project = project_of(member)
  assert project["name"] == module_folder(member).name.replace("_", "-")
  assert project["license"] == "Apache-2.0"
  # A wheel carries the licence's text, and holds nothing from outside of its member.
  assert project["license-files"] == ["LICENSE"]
  assert (member / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()
  assert project["readme"] == "README.md"
  assert project["description"]
  assert re.fullmatch(r"\d+\.\d+\.\d+", project["version"])


@each_member
def test_siblings_are_required_by_a_range_that_holds_their_present_version(member: Path) -> None:
  project = project_of(member)
  versions = {other["name"]: other["version"] for other in map(project_of, MEMBERS)}
  extras = project.get("optional-dependencies", {}).values()
  for requirement in [*project["dependencies"], *(entry for extra in extras for entry in extra)]:
    if (name := re.split(r"[^\w-]", requirement)[0]) in versions:
      found = re.fullmatch(r"[\w-]+(?:\[[\w,-]+\])?>=([\d.]+),<([\d.]+)", requirement)
      assert found, f"{requirement}: expected a range such as >=0.2,<0.3"
      low, version, high = (tuple(map(int, text.split("."))) for text in (found[1], versions[name], found[2]))
      assert low <= version < high, requirement


@each_member
def test_member_has_a_changelog_with_its_version(member: Path) -> None:
  project = project_of(member)
  text = (member / "CHANGELOG.md").read_text(encoding="utf-8")
  assert text.startswith(f"# Changelog of {project['name']}\n")
  headings = re.findall(r"^## \[(.+?)\](?: - \d{4}-\d\d-\d\d)?$", text, re.MULTILINE)
  assert headings[:2] == ["Unreleased", project["version"]]
  for version in text.split("\n## ")[1:]:
    found = re.findall(r"^### (.+)$", version, re.MULTILINE)
    assert set(found) <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    assert len(found) == len(set(found)), f"{version.partition(']')[0]}] has one kind of change twice: {found}"


@each_member
def test_public_face_is_listed(member: Path) -> None:
  tree = ast.parse((module_folder(member) / "__init__.py").read_text(encoding="utf-8"))
  assert "__all__" in [
    ast.unparse(target) for node in tree.body if isinstance(node, ast.Assign) for target in node.targets
  ]
  assert ast.get_docstring(tree)


@each_member
def test_readme_has_an_example_and_a_test_runs_it(member: Path) -> None:
  assert python_blocks(member / "README.md"), "no python example"
  tests = [path.read_text(encoding="utf-8") for path in (member / "tests").glob("test_*.py")]
  runs = [test for test in tests if "run_readme(" in test or ("README.md" in test and "exec(" in test)]
  assert runs, "no test runs the example"


@each_member
def test_readme_has_an_introduction_the_install_command_and_a_first_example(member: Path) -> None:
  introduction, *rest = re.split(r"^## ", (member / "README.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
  assert [line for line in introduction.splitlines()[1:] if line]
  assert [part.splitlines()[0] for part in rest[:2]] == ["Install", "First example"]


@each_member
def test_module_tables_name_modules_that_exist(member: Path) -> None:
  tables = re.findall(
    r"^\| module \|.*\n\|[-|]+\n((?:\|.*\n)+)", (member / "README.md").read_text(encoding="utf-8"), re.MULTILINE
  )
  cells = [row.split("|")[1] for table in tables for row in table.splitlines()]
  named = [name for cell in cells for name in re.findall(r"`([\w/.]+)`", cell)]
  assert [name for name in named if not list(module_folder(member).glob(f"{name.removesuffix('.py')}*"))] == []


def test_names_of_test_files_are_unique() -> None:
  counts = Counter(path.name for folder in (*MEMBERS, ROOT) for path in (folder / "tests").rglob("test_*.py"))
  assert [name for name, count in counts.items() if count > 1] == []


@each_member
def test_names_of_test_files_start_with_the_member(member: Path) -> None:
  strangers = [path.name for path in (member / "tests").rglob("test_*.py")]
  assert [name for name in strangers if not name.startswith(f"test_{member.name}_")] == []


def test_no_module_is_a_drawer_for_everything() -> None:
  drawers = {"utils.py", "util.py", "helpers.py", "common.py", "misc.py"}
  assert [path for path in tracked_files() if path.name in drawers] == []


@each_member
def test_folders_have_at_most_a_dozen_modules(member: Path) -> None:
  counts = Counter(path.parent for path in module_folder(member).rglob("*.py") if path.name != "__init__.py")
  # The folder of commands has one module per command.
  assert {folder.name for folder, count in counts.items() if count > 12} <= {"cli"}


def test_links_in_documents_lead_somewhere() -> None:
  broken = []
  for path in tracked_files():
    if path.suffix == ".md":
      for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", path.read_text(encoding="utf-8")):
        if "://" not in target and not (path.parent / target).exists():
          broken.append(f"{path.relative_to(ROOT)}: {target}")
  assert broken == []


def test_prose_of_readmes_fits_130_columns() -> None:
  wide = []
  for path in tracked_files():
    if path.name in ("README.md", "CONTRIBUTING.md"):
      is_code = False
      for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        is_code ^= line.lstrip().startswith("```")
        if len(line) > 130 and not is_code and not line.startswith(("|", "![")):
          wide.append(f"{path.relative_to(ROOT)}:{number}")
  assert wide == []


def test_nothing_of_the_workshop_is_left_in_the_repository() -> None:
  # Absolute paths of a machine, folders beside the clone, merge leftovers, and names of assistants.
  assistants = "|".join(("clau" + "de", "anthro" + "pic", "copi" + "lot", "open" + "ai", "chat" + "gpt"))
  signs = re.compile(
    r"(?<![\w.)}>/-])/(?:work|root|home|tmp|mnt|Users)/\w"
    + r"|(?<![\w-])\.\./shared/|(?<![\w/.-])shared/\w"
    + r"|^(?:<{7} |={7}$|>{7} )"
    + rf"|\b(?:{assistants})\b"
    + r"|\bTODO\b|\bFIXME\b",
    re.MULTILINE | re.IGNORECASE,
  )
  found = []
  for path in tracked_files():
    if path in (Path(__file__), ROOT / "uv.lock"):
      continue
    text = text_of(path)
    found += [
      f"{path.relative_to(ROOT)}:{text.count(chr(10), 0, hit.start()) + 1}: {hit[0]}" for hit in signs.finditer(text)
    ]
  assert found == []


def test_no_file_is_large() -> None:
  assert [path for path in tracked_files() if path.stat().st_size > 2_000_000] == []


def test_readme_gives_the_test_command_that_ci_runs() -> None:
  assert "\nuv run pytest -n 2\n" in (ROOT / "README.md").read_text(encoding="utf-8")
  assert "uv run pytest -n 2 " in (ROOT / ".ci" / "run").read_text(encoding="utf-8")


def test_root_readme_names_every_member() -> None:
  readme = (ROOT / "README.md").read_text(encoding="utf-8")
  assert [m.name for m in MEMBERS if f"]({m.relative_to(ROOT).as_posix()})" not in readme] == []


def test_root_readme_python_blocks_run() -> None:
  for block in python_blocks(ROOT / "README.md"):
    exec(compile(block, "README.md", "exec"), {})


@pytest.mark.parametrize("document", [ROOT, *MEMBERS], ids=lambda folder: folder.name)
def test_readme_installs_from_the_clone(document: Path) -> None:
  # On the public index, these names are free or belong to other projects.
  assert not re.search(r"pip install ['\"]?mjlab", (document / "README.md").read_text(encoding="utf-8"))
