"""Reference of the public API, from signatures and docstrings of the source."""

import json
from collections.abc import Iterator, Sequence
from typing import TypeAlias

import griffe

from mjlab_docs import sources
from mjlab_docs.pages import Site, members

Described: TypeAlias = griffe.Class | griffe.Function | griffe.Attribute | griffe.TypeAlias


def write(site: Site) -> dict[str, str]:
  """Write `reference/api/MODULE.md` for each package and subpackage with a public API.

  Returns:
    Module that documents each object, by the path of the object's definition.
  """
  folders = [member / "src" for member in members()]
  loader = griffe.GriffeLoader(
    search_paths=folders, docstring_parser="google", docstring_options={"warnings": False}, allow_inspection=False
  )
  packages = [
    package.name for folder in folders for package in sorted(folder.iterdir()) if (package / "__init__.py").is_file()
  ]
  for package in packages:
    loader.load(package)
  loader.resolve_aliases(implicit=True, external=False)
  modules = [module for package in packages for module in _public_modules(loader.modules_collection[package])]
  homes: dict[str, str] = {}  # the module that documents each object: the first of the package that defines it
  for module in modules:
    for _, found in _public(module):
      if found.package.path == module.package.path:
        homes.setdefault(found.path, module.path)
  sources.remember({f"{module.path}.{name}": found.module for module in modules for name, found in _public(module)})
  for module in modules:
    site.write(f"reference/api/{module.path}.md", "\n".join(_page(module, homes)) + "\n")
  return homes


def _public_modules(module: griffe.Module) -> Iterator[griffe.Module]:
  """Yield a package and its subpackages that list their public names."""
  if module.exports:
    yield module
  for child in module.modules.values():
    if not child.is_alias and child.is_init_module:
      yield from _public_modules(child)


def _public(module: griffe.Module) -> Iterator[tuple[str, Described]]:
  """Yield the public names of a module, with what they are where they are defined."""
  for name in module.exports or ():
    found = module.members.get(str(name))
    if found is None:
      continue
    try:
      target = found.final_target if isinstance(found, griffe.Alias) else found
    except griffe.AliasResolutionError:
      continue
    if isinstance(target, Described):
      yield str(name), target


def _page(module: griffe.Module, homes: dict[str, str]) -> Iterator[str]:
  """Yield the lines of the page of a module; names of another member's API are links."""
  yield f"# {module.path}\n"
  yield from _prose(module.docstring)
  yield f"\n```{{py:module}} {module.path}\n```\n"
  own: dict[str, list[tuple[str, Described]]] = {}
  elsewhere = []
  for name, found in _public(module):
    if homes.get(found.path, module.path) != module.path:
      elsewhere.append(f"- {{py:obj}}`{name} <{homes[found.path]}.{name}>`")
    else:
      own.setdefault(found.module.path, []).append((name, found))
  for path, found in own.items():
    if len(own) > 1:
      title = path.removeprefix(f"{module.path}.").replace("_", " ").replace(".", ": ").strip()
      yield f"## {title[:1].upper()}{title[1:]}\n"
      if path != module.path:
        yield from _prose(found[0][1].module.docstring)
    for name, described in found:
      yield from _object(name, described, module.path)
  if elsewhere:
    yield "## From other packages\n"
    yield from elsewhere


def _object(name: str, found: Described, module: str) -> Iterator[str]:
  """Yield the lines of one public name."""
  options = f":module: {module}\n"
  if isinstance(found, griffe.Function):
    yield f":::{{py:function}} {name}{_signature(found)}\n{options}"
    yield from _prose(found.docstring)
    yield ":::\n"
  elif isinstance(found, griffe.Class):
    is_config = "dataclass" in found.labels
    init = found.all_members.get("__init__")
    arguments = "" if is_config or not isinstance(init, griffe.Function) else _signature(init, method=True)
    yield f"::::{{py:class}} {name}{arguments}\n{options}"
    bases = [str(base) for base in found.bases if str(base) not in ("Protocol", "ABC")]
    yield from _prose(found.docstring)
    if bases:
      yield f"Bases: {', '.join(f'`{base}`' for base in bases)}\n"
    yield from _members(name, found, module, inherited=is_config)
    yield "::::\n"
  else:
    yield f":::{{py:data}} {name}\n{options}{_value(found)}\n"
    yield from _prose(found.docstring)
    yield ":::\n"


def _members(owner: str, found: griffe.Class, module: str, *, inherited: bool) -> Iterator[str]:
  """Yield the public fields and methods of a class; those that configs inherit are theirs too."""
  for name, member in (found.all_members if inherited else found.members).items():
    target = member.final_target if isinstance(member, griffe.Alias) else member
    if name.startswith("_") or not isinstance(target, griffe.Function | griffe.Attribute):
      continue
    if isinstance(target, griffe.Function):
      if target.parent is not found and inherited:
        continue
      kinds = {"classmethod": ":classmethod:", "staticmethod": ":staticmethod:", "async": ":async:"}
      labels = "".join(f"{option}\n" for label, option in kinds.items() if label in target.labels)
      yield f":::{{py:method}} {owner}.{name}{_signature(target, method=True)}\n:module: {module}\n{labels}"
    else:
      if target.docstring is None and target.annotation is None and "class-attribute" not in target.labels:
        continue
      yield f":::{{py:attribute}} {owner}.{name}\n:module: {module}\n{_value(target)}\n"
    yield from _prose(target.docstring)
    yield ":::\n"


def _value(found: griffe.Attribute | griffe.TypeAlias) -> str:
  """Return the options for type and default of a field."""
  # Options are YAML, of which JSON is a part.
  text = (
    f":type: {json.dumps(str(found.annotation))}\n"
    if isinstance(found, griffe.Attribute) and found.annotation is not None
    else ""
  )
  if found.value is not None and "property" not in found.labels:
    value = " ".join(str(found.value).split())
    text += f":value: {json.dumps(value if len(value) <= 160 else '...')}\n"
  return text


def _signature(function: griffe.Function, *, method: bool = False) -> str:
  """Return the arguments and the type returned, as in the source."""
  words: list[str] = []
  seen = ""
  for index, parameter in enumerate(function.parameters):
    kind = parameter.kind
    if method and index == 0 and parameter.name in ("self", "cls"):
      continue
    if seen == "/" and kind is not griffe.ParameterKind.positional_only:
      words.append("/")
    seen = "/" if kind is griffe.ParameterKind.positional_only else ""
    if kind is griffe.ParameterKind.keyword_only and not any(word.startswith("*") for word in words):
      words.append("*")
    stars = (
      {griffe.ParameterKind.var_positional: "*", griffe.ParameterKind.var_keyword: "**"}.get(kind, "") if kind else ""
    )
    word = f"{stars}{parameter.name}"
    if parameter.annotation is not None:
      word += f": {parameter.annotation}"
    if parameter.default is not None and not stars:
      word += f" = {parameter.default}" if parameter.annotation is not None else f"={parameter.default}"
    words.append(" ".join(word.split()))
  returned = "" if function.returns is None or function.name == "__init__" else f" -> {function.returns}"
  return f"({', '.join(words)}){returned}"


def _prose(docstring: griffe.Docstring | None) -> Iterator[str]:
  """Yield a docstring as Markdown: its text, then arguments, results and errors."""
  if docstring is None:
    return
  titles = {
    "parameters": "Arguments",
    "raises": "Raises",
    "returns": "Returns",
    "yields": "Yields",
    "attributes": "Fields",
  }
  for section in docstring.parsed:
    kind = section.kind.value
    if kind == "text":
      yield f"{section.value}\n"
    elif kind in titles:
      yield f"{titles[kind]}:\n"
      yield from _items(section.value)
      yield ""
    elif kind == "examples":
      yield from (
        f"```python\n{text}\n```\n" if part.value == "examples" else f"{text}\n" for part, text in section.value
      )
    elif kind == "admonition":
      yield f"{section.title}: {section.value.description}\n"


def _items(values: Sequence[griffe.DocstringNamedElement]) -> Iterator[str]:
  for value in values:
    name = getattr(value, "name", "") or getattr(value, "annotation", "") or ""
    description = " ".join(value.description.split())
    yield f"- `{name}`: {description}" if name else f"- {description}"
