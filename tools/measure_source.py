"""Size and structure of the source: `uv run python tools/measure_source.py [--list FIGURE]`.

Prints a Markdown table with one row per member. `docs/source.md` is its committed output.
"""

import argparse
import ast
import io
import re
import sys
import tokenize
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

ROOT = Path(__file__).parents[1]
LAYOUT = {
  tokenize.COMMENT,
  tokenize.NL,
  tokenize.NEWLINE,
  tokenize.INDENT,
  tokenize.DEDENT,
  tokenize.ENCODING,
  tokenize.ENDMARKER,
}
QUESTION = re.compile(r"(what|whether|who|whoever|whom|whose|how|where|which|why)\b", re.IGNORECASE)
# The modules of each library in which its private names may be used. Managers do not import sim.
PRIVATE_HOMES = {
  "mujoco_warp": ("mjlab_sim.warp.internals",),
  "warp": ("mjlab_sim.warp.solver.tile_solvers",),
  "torch": ("mjlab_core.torch_internals",),
  "mjviser": ("mjlab_viewer.browser.world.mjviser_scene",),
  "viser": ("mjlab_viewer.browser.viser_internals",),
}
# Private attributes of tensors. They count on every object but `self`, also where a member defines an equal name.
OF_TENSORS = {"_base", "_is_view", "_version"}
# Public names of named tuples, in spite of their form.
NAMED_TUPLE = {"_asdict", "_fields", "_replace", "_make"}
Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True)
class Module:
  """One Python file of a member's source."""

  name: str
  path: Path

  @cached_property
  def text(self) -> str:
    return self.path.read_text(encoding="utf-8")

  @cached_property
  def nodes(self) -> list[ast.AST]:
    return list(ast.walk(ast.parse(self.text)))

  @property
  def where(self) -> str:
    return self.path.relative_to(ROOT).as_posix()


@dataclass(frozen=True)
class Member:
  """One member of the workspace."""

  name: str
  folder: Path

  @property
  def package(self) -> str:
    return "mjlab" if self.name == "mjlab" else f"mjlab_{self.name}"

  @cached_property
  def modules(self) -> list[Module]:
    found = []
    for path in sorted((self.folder / "src").rglob("*.py")):
      parts = path.relative_to(self.folder / "src").with_suffix("").parts
      found.append(Module(".".join(parts[:-1] if parts[-1] == "__init__" else parts), path))
    return found


@cache
def members() -> list[Member]:
  """Return all members, in the order of their names."""
  folders = [path.parent for path in [*ROOT.glob("packages/*/pyproject.toml"), *ROOT.glob("tasks/*/pyproject.toml")]]
  return sorted((Member(folder.name, folder) for folder in folders), key=lambda member: member.name)


def tokens(module: Module) -> int:
  """Return the number of tokens; comments and layout do not count, and a string is one token whatever its length."""
  count = depth = 0
  for token in tokenize.generate_tokens(io.StringIO(module.text).readline):
    # Since Python 3.12 an f-string has several tokens.
    kind = tokenize.tok_name[token.type]
    depth += kind == "FSTRING_START"
    count += depth == 0 and token.type not in LAYOUT
    if kind == "FSTRING_END":
      depth -= 1
      count += depth == 0
  return count


def validating_lines(module: Module) -> list[int]:
  """Return the lines that raise errors, the conditions that lead only to them, and functions that do nothing else."""
  lines: set[int] = set()
  for node in module.nodes:
    if (isinstance(node, Function) and _only_validates(node)) or (
      isinstance(node, ast.stmt) and _leads_to_errors(node)
    ):
      lines.update(range(node.lineno, _end(node) + 1))
    elif isinstance(node, ast.If) and _raises(node.body[-1]):
      lines.update(range(node.lineno, _end(node.body[-1]) + 1))
  text = module.text.splitlines()
  return sorted(line for line in lines if text[line - 1].strip() and not text[line - 1].lstrip().startswith("#"))


def _end(node: ast.stmt) -> int:
  return node.end_lineno or node.lineno


def _raises(node: ast.stmt) -> bool:
  return isinstance(node, ast.Raise) and node.exc is not None


def _leads_to_errors(node: ast.stmt) -> bool:
  """Return True for a raise, and for a branch or loop in which there is nothing else."""
  if isinstance(node, ast.If | ast.For | ast.While):
    return all(_leads_to_errors(inner) for inner in [*node.body, *node.orelse])
  return _raises(node)


def _only_validates(statement: ast.stmt) -> bool:
  """Return True for a function that can raise an error, gives nothing back, and writes to nothing but its own names."""
  nodes = list(ast.walk(statement))
  if not isinstance(statement, Function) or not any(isinstance(node, ast.Raise) and node.exc for node in nodes):
    return False
  gives = any(isinstance(node, ast.Return) and node.value is not None for node in nodes)
  gives |= any(isinstance(node, ast.Yield | ast.YieldFrom | ast.AugAssign | ast.With) for node in nodes)
  gives |= any(isinstance(node, ast.Call) and ast.unparse(node.func) == "setattr" for node in nodes)
  targets = [target for node in nodes if isinstance(node, ast.Assign) for target in node.targets]
  return not gives and all(isinstance(target, ast.Name | ast.Tuple) for target in targets)


def classes(module: Module) -> Iterator[tuple[ast.ClassDef, list[str]]]:
  """Yield every class with the names of its bases."""
  for node in module.nodes:
    if isinstance(node, ast.ClassDef):
      bases = [base.value if isinstance(base, ast.Subscript) else base for base in node.bases]
      yield node, [ast.unparse(base).rpartition(".")[2] for base in bases]


def exception_classes(module: Module) -> list[str]:
  """Return the exception classes of a module."""
  return [node.name for node, bases in classes(module) if any(re.search(r"(Error|Exception)$", base) for base in bases)]


def protocols(module: Module) -> list[str]:
  """Return the protocols of a module."""
  return [node.name for node, bases in classes(module) if "Protocol" in bases]


def questions(module: Module) -> list[str]:
  """Return the docstrings, also those of fields, that begin with a question word."""
  found = []
  for node in module.nodes:
    body = getattr(node, "body", None)
    for statement in body if isinstance(body, list) else []:
      value = statement.value if isinstance(statement, ast.Expr) else None
      if isinstance(value, ast.Constant) and isinstance(value.value, str) and QUESTION.match(value.value.strip()):
        found.append(f"{module.where}:{statement.lineno}: {value.value.strip().splitlines()[0]}")
  return found


def imported(module: Module) -> Iterator[tuple[int, str, str | None]]:
  """Yield (line, module, name or None) of every import, those for type hints included."""
  for node in module.nodes:
    if isinstance(node, ast.Import):
      yield from ((node.lineno, alias.name, None) for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
      yield from ((node.lineno, node.module or "", alias.name) for alias in node.names)


def import_circles(member: Member) -> list[list[str]]:
  """Return the groups of a member's modules that import each other, directly or through others."""
  names = {module.name for module in member.modules}
  edges: dict[str, set[str]] = {}
  for module in member.modules:
    # A name of a package may be a module; importing a module of a package does not count as importing the package.
    found = (f"{source}.{name}" if f"{source}.{name}" in names else source for _, source, name in imported(module))
    edges[module.name] = {target for target in found if target in names and target != module.name}
  return [group for group in _strongly_connected(edges) if len(group) > 1]


def _strongly_connected(edges: dict[str, set[str]]) -> list[list[str]]:
  reach = {start: _reachable(start, edges) for start in edges}
  groups = {frozenset(other for other in reach[name] if name in reach[other]) | {name} for name in edges}
  return sorted(sorted(group) for group in groups)


def _reachable(start: str, edges: dict[str, set[str]]) -> set[str]:
  seen: set[str] = set()
  waiting = [start]
  while waiting:
    new = edges[waiting.pop()] - seen
    seen |= new
    waiting += new
  return seen


def private_names(member: Member) -> list[tuple[Module, int, str, str]]:
  """Return (module, line, package, name) of the private names that a member takes from elsewhere.

  Elsewhere is another package, or another module where the name of a private object is imported. An attribute counts if
  no module of the member defines it; its package is that of the name it is reached through, "" if that is not known.
  """
  defined = {name for module in member.modules for name in _defined(module)} | NAMED_TUPLE
  found = []
  for module in member.modules:
    packages: dict[str, str] = {}
    for line, source, name in imported(module):
      top = source.partition(".")[0]
      parts = [*source.split("."), *([name] if name is not None else [])]
      is_foreign = top not in (member.package, "__future__") and any(_is_private(part) for part in parts)
      is_object = name is not None and _is_private(name) and ".".join(parts) not in {m.name for m in member.modules}
      if is_foreign or is_object or parts[:2] == ["unittest", "mock"]:
        found.append((module, line, top, ".".join(parts)))
      packages[(name or source).partition(".")[0]] = top
    for node in module.nodes:
      if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
        named = node.args[0].value if isinstance(node.args[0], ast.Constant) else ""
        top, *rest = str(named).split(".")
        if top != member.package and any(map(_is_private, rest)):
          found.append((module, node.lineno, top, str(named)))
      if not isinstance(node, ast.Attribute) or not _is_private(node.attr):
        continue
      is_of_tensor = node.attr in OF_TENSORS and ast.unparse(node.value) not in ("self", "cls")
      if is_of_tensor or node.attr not in defined:
        chain = ast.unparse(node)
        found.append((module, node.lineno, packages.get(chain.partition(".")[0], ""), chain))
  return found


def _defined(module: Module) -> Iterator[str]:
  for node in module.nodes:
    if isinstance(node, ast.ClassDef | Function):
      yield node.name
    elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
      yield node.id
    elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store) and ast.unparse(node.value) == "self":
      yield node.attr


def _is_private(name: str) -> bool:
  return name.startswith("_") and not name.startswith("__")


def stray_private_names(member: Member) -> list[str]:
  """Return the private names that are used outside the modules of their library."""
  homes = {name for names in PRIVATE_HOMES.values() for name in names}
  return [
    f"{module.where}:{line}: {name}"
    for module, line, package, name in private_names(member)
    if module.name not in (PRIVATE_HOMES.get(package, ()) if package else homes)
  ]


def _of_modules(find: Callable[[Module], list[str]]) -> Callable[[Member], list[str]]:
  return lambda member: [
    line if ":" in line else f"{module.where}: {line}" for module in member.modules for line in find(module)
  ]


def _sized(member: Member, least: int, most: int) -> list[str]:
  sizes = ((module.where, len(module.text.splitlines())) for module in member.modules)
  return [f"{where}: {lines}" for where, lines in sizes if least <= lines <= most]


# Figures with a list of places behind them.
LISTED: dict[str, Callable[[Member], list[str]]] = {
  "lines that only validate": _of_modules(lambda module: [f"{module.where}:{n}" for n in validating_lines(module)]),
  "exception classes": _of_modules(exception_classes),
  "protocols": _of_modules(protocols),
  "modules under 50 lines": lambda member: [line for line in _sized(member, 1, 49) if "__init__.py" not in line],
  "modules over 400 lines": lambda member: _sized(member, 401, sys.maxsize),
  "import circles": lambda member: [" ".join(group) for group in import_circles(member)],
  "stray private names": stray_private_names,
  "docstrings that ask": _of_modules(questions),
}


def tests_of(folder: Path) -> int:
  """Return the number of lines of Python in a folder of tests."""
  return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in folder.rglob("*.py"))


def table() -> str:
  """Return all figures as a Markdown table."""
  head = ["member", "tokens", "modules", *LISTED, "lines of tests"]
  figures: dict[str, list[int]] = {}
  for member in members():
    size = [sum(tokens(module) for module in member.modules), len(member.modules)]
    figures[member.name] = [*size, *(len(find(member)) for find in LISTED.values()), tests_of(member.folder / "tests")]
  figures["(whole workspace)"] = [0] * (len(LISTED) + 2) + [tests_of(ROOT / "tests")]
  figures["total"] = [sum(column) for column in zip(*figures.values(), strict=True)]
  rows = [[name, *map(str, numbers)] for name, numbers in figures.items()]
  lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
  return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def main() -> int:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--list", metavar="FIGURE", help=f"print the places behind a figure: {', '.join(LISTED)}")
  parser.add_argument("--member", metavar="MEMBER", help="only of this member")
  arguments = parser.parse_args()
  chosen = [member for member in members() if arguments.member in (None, member.name)]
  if not chosen:
    parser.error(f"--member {arguments.member}: there are {', '.join(member.name for member in members())}")
  if arguments.list is None:
    print(table())
    return 0
  figures = [figure for figure in LISTED if arguments.list in figure]
  if not figures:
    parser.error(f"--list {arguments.list}: there are {', '.join(LISTED)}")
  for figure in figures:
    for member in chosen:
      print("".join(f"{line}\n" for line in LISTED[figure](member)), end="")
  return 0


if __name__ == "__main__":
  sys.exit(main())
