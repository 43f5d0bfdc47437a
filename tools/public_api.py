"""Public API of the members, as text: `uv run python tools/public_api.py [--check] [--write] [MEMBER ...]`.

`api.txt` of a member lists its public API at its last release. `--check` fails if the API has changed since then and
the member's changelog has no Unreleased entry. A release rewrites the list; `--write` does so without a release.
"""

import argparse
import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
Function = ast.FunctionDef | ast.AsyncFunctionDef


def members(root: Path = ROOT) -> dict[str, Path]:
  """Return the folders of all members by name."""
  projects = [*root.glob("packages/*/pyproject.toml"), *root.glob("tasks/*/pyproject.toml")]
  return {path.parent.name: path.parent for path in sorted(projects, key=lambda path: path.parent.name)}


def public_api(folder: Path) -> str:
  """Return the public API of a member: one line per name, with arguments, fields and methods.

  Public are the names in `__all__` of the package, and of its subpackages that have one.
  """
  (package,) = [path for path in (folder / "src").iterdir() if (path / "__init__.py").is_file()]
  lines = []
  for init in sorted(package.rglob("__init__.py")):
    tree = _tree(init)
    prefix = ".".join(init.parent.relative_to(folder / "src").parts)
    for name in _exported(tree):
      lines += [f"{prefix}.{line}" for line in _described(name, init, folder / "src")]
  return "".join(f"{line}\n" for line in sorted(lines))


def unreleased(folder: Path) -> str:
  """Return the Unreleased section of a member's changelog."""
  text = (folder / "CHANGELOG.md").read_text(encoding="utf-8")
  found = re.search(r"^## \[Unreleased\]\n(.*?)(?=^## |\Z)", text, re.DOTALL | re.MULTILINE)
  return found[1].strip() if found else ""


def check(folder: Path) -> str:
  """Return an error if the public API of a member has changed without an Unreleased entry, else an empty text."""
  released = set((folder / "api.txt").read_text(encoding="utf-8").splitlines())
  now = set(public_api(folder).splitlines())
  if now == released or unreleased(folder):
    return ""
  changes = [f"  - {line}" for line in sorted(released - now)] + [f"  + {line}" for line in sorted(now - released)]
  return "\n".join(
    [f"{folder.name}: the public API has changed; describe it below Unreleased in {folder.name}/CHANGELOG.md", *changes]
  )


def _tree(path: Path) -> ast.Module:
  return ast.parse(path.read_text(encoding="utf-8"))


def _exported(tree: ast.Module) -> list[str]:
  for node in tree.body:
    if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
      return [str(name) for name in ast.literal_eval(node.value)]
  return []


def _described(name: str, module: Path, src: Path, depth: int = 0) -> Iterator[str]:
  """Yield the lines of one name, from the module that defines it."""
  for node in ast.walk(_tree(module)):
    if isinstance(node, Function | ast.ClassDef) and node.name == name:
      yield from _lines(node, name)
      return
    if isinstance(node, ast.ImportFrom) and node.module and depth < 5:
      for alias in node.names:
        source = _module_path(node.module, src)
        if (alias.asname or alias.name) == name and source is not None:
          yield from _described(alias.name, source, src, depth + 1)
          return
  yield name


def _module_path(module: str, src: Path) -> Path | None:
  path = src.joinpath(*module.split("."))
  return next((found for found in (path.with_suffix(".py"), path / "__init__.py") if found.is_file()), None)


def _lines(node: Function | ast.ClassDef, name: str) -> Iterator[str]:
  if not isinstance(node, ast.ClassDef):
    yield f"{name}({ast.unparse(node.args)})"
    return
  bases = ", ".join(ast.unparse(base) for base in node.bases)
  yield f"{name}({bases})" if bases else name
  for item in node.body:
    if isinstance(item, Function) and (not item.name.startswith("_") or item.name in ("__init__", "__call__")):
      yield f"{name}.{item.name}({ast.unparse(item.args)})"
    elif isinstance(item, ast.AnnAssign) and not ast.unparse(item.target).startswith("_"):
      yield f"{name}.{ast.unparse(item)}"


def main() -> int:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("members", nargs="*", metavar="MEMBER", help=f"default: all ({', '.join(members())})")
  parser.add_argument("--check", action="store_true", help="fail if a changed API has no Unreleased entry")
  parser.add_argument("--write", action="store_true", help="write api.txt")
  arguments = parser.parse_args()
  missing = [member for member in arguments.members if member not in members()]
  if missing:
    parser.error(f"no such member: {', '.join(missing)}. There are {', '.join(members())}")
  folders = [folder for name, folder in members().items() if name in (arguments.members or members())]
  for folder in folders:
    if arguments.write:
      (folder / "api.txt").write_text(public_api(folder), encoding="utf-8")
    elif not arguments.check:
      print(public_api(folder), end="")
  errors = [error for folder in folders if arguments.check and (error := check(folder))]
  print("\n".join(errors), end="\n" * bool(errors))
  return 1 if errors else 0


if __name__ == "__main__":
  sys.exit(main())
