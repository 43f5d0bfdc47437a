"""Public API of the members, as text: `uv run python tools/public_api.py [--check] [--write] [MEMBER ...]`.

`api.txt` of a member lists its public API at its last release. `--check` fails if the API has changed since then and
the member's changelog has no Unreleased entry. A release rewrites the list; `--write` does so without a release.
"""

import argparse
import ast
import re
import sys
from collections.abc import Collection, Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
Function = ast.FunctionDef | ast.AsyncFunctionDef


def members(root: Path = ROOT) -> dict[str, Path]:
  """Return the folders of all members by name."""
  projects = [*root.glob("packages/*/pyproject.toml"), *root.glob("tasks/*/pyproject.toml")]
  return {path.parent.name: path.parent for path in sorted(projects, key=lambda path: path.parent.name)}


def public_api(folder: Path) -> str:
  """Return the public API of a member: one line per name, with arguments, fields and methods.

  Public are the names in `__all__` of the package, and of its subpackages that have one. A class has the members of its
  bases too, unless a base is public itself.
  """
  src = folder / "src"
  (package,) = [path for path in src.iterdir() if (path / "__init__.py").is_file()]
  exported = {init: _exported(_tree(init)) for init in sorted(package.rglob("__init__.py"))}
  public = {name for names in exported.values() for name in names}
  lines = set()
  for init, names in exported.items():
    prefix = ".".join(init.parent.relative_to(src).parts)
    for name in names:
      node, module = _definition(name, init, src)
      described = [name] if node is None else _lines(node, name, module, src, public)
      lines |= {f"{prefix}.{line}" for line in described}
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


def _definition(name: str, module: Path, src: Path, depth: int = 0) -> tuple[Function | ast.ClassDef | None, Path]:
  """Return the function or class that a name of a module is, and the module that defines it; None for other names."""
  for node in ast.walk(_tree(module)):
    if isinstance(node, Function | ast.ClassDef) and node.name == name:
      return node, module
    if isinstance(node, ast.ImportFrom) and node.module and depth < 5:
      for alias in node.names:
        source = _module_path(node.module, src)
        if (alias.asname or alias.name) == name and source is not None:
          return _definition(alias.name, source, src, depth + 1)
  return None, module


def _module_path(module: str, src: Path) -> Path | None:
  path = src.joinpath(*module.split("."))
  return next((found for found in (path.with_suffix(".py"), path / "__init__.py") if found.is_file()), None)


def _lines(node: Function | ast.ClassDef, name: str, module: Path, src: Path, public: Collection[str]) -> Iterator[str]:
  if not isinstance(node, ast.ClassDef):
    yield f"{name}({ast.unparse(node.args)})"
    return
  bases = ", ".join(ast.unparse(base) for base in node.bases)
  yield f"{name}({bases})" if bases else name
  for member, lines in _members(node, module, src, public).items():
    yield from (f"{name}.{member}{line}" for line in lines)


def _members(node: ast.ClassDef, module: Path, src: Path, public: Collection[str]) -> dict[str, list[str]]:
  """Return arguments of methods and types of fields by name, also those of bases that are not public."""
  found: dict[str, list[str]] = {}
  for base in reversed(node.bases):
    definition, place = _definition(ast.unparse(base).partition("[")[0], module, src)
    if isinstance(definition, ast.ClassDef) and definition.name not in public:
      found |= _members(definition, place, src, public)
  own: dict[str, list[str]] = {}
  for item in node.body:
    if isinstance(item, Function) and (not item.name.startswith("_") or item.name in ("__init__", "__call__")):
      own.setdefault(item.name, []).append(f"({ast.unparse(item.args)})")
    elif isinstance(item, ast.AnnAssign | ast.Assign):
      field = ast.unparse(item.target if isinstance(item, ast.AnnAssign) else item.targets[0])
      if not field.startswith("_"):
        own[field] = [ast.unparse(item).removeprefix(field)]
  return found | own


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
