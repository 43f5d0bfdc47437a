"""Pages of the repository, laid out as the pages of the site, with links between them."""

import os
import re
import shutil
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).parents[3]
_LINK = re.compile(r"(!?\[(?:[^\[\]]|\[[^\]]*\])*\])\(([^)\s#]*)(#[^)\s]*)?\)")
_FENCE = re.compile(r"^(`{3,}|~{3,}|:{3,}).*?^\1[ ]*$", re.MULTILINE | re.DOTALL)
# Pages of one table each, which no contents name.
_TABLES = {"benchmarks/index.md": "\n```{toctree}\n:caption: Tables\n:maxdepth: 1\n:glob:\n\n*\n```\n"}
# Files of numbers, to be downloaded.
_DATA = {".csv", ".json"}
_PICTURES = {".png", ".webp", ".svg", ".gif", ".mp4"}


class Site:
  """Source of the site in a folder that Sphinx reads.

  Files whose text has not changed keep their time, so that Sphinx reads only what has.

  Args:
    folder: Folder of the source; what this build does not write is removed by `close`.
  """

  def __init__(self, folder: Path) -> None:
    self.folder = folder
    self.written: set[Path] = set()
    self.addresses = _addresses()
    self._sources: set[str] = set()

  def write(self, place: str, text: str) -> None:
    """Write a page at a place below the folder."""
    path = self.folder / place
    self.written.add(path)
    if not path.is_file() or path.read_text(encoding="utf-8") != text:
      path.parent.mkdir(parents=True, exist_ok=True)
      path.write_text(text, encoding="utf-8")

  def copy(self, source: Path, place: str) -> None:
    """Copy a file to a place below the folder."""
    path = self.folder / place
    self.written.add(path)
    if not path.is_file() or path.stat().st_mtime_ns != source.stat().st_mtime_ns:
      path.parent.mkdir(parents=True, exist_ok=True)
      shutil.copy2(source, path)

  def lay_out(self) -> None:
    """Write every page of the repository and every picture."""
    contents = [path.read_text(encoding="utf-8") for path in sorted((ROOT / "docs").rglob("index.md"))]
    listed = " ".join(block for text in contents for block in re.findall(r"```{toctree}.*?```", text, re.DOTALL))
    for path, place in self.addresses.items():
      text = self.linked((ROOT / path).read_text(encoding="utf-8"), path, place) + _TABLES.get(place, "")
      self.write(place, text + (_guides(listed) if place == "tutorials/index.md" else ""))
    for picture in sorted((ROOT / "docs").rglob("*")):
      if picture.suffix in _PICTURES or picture.parent.name == "_static":
        self.copy(picture, picture.relative_to(ROOT / "docs").as_posix())
    self.copy(ROOT / "docs" / "conf.py", "conf.py")
    for source in sorted(self._sources):
      if PurePosixPath(source).suffix in _DATA:
        self.copy(ROOT / source, f"source/{source}")
        continue
      language = {".py": "python", ".toml": "toml", ".xml": "xml"}.get(PurePosixPath(source).suffix, "text")
      text = (ROOT / source).read_text(encoding="utf-8")
      self.write(
        f"source/{source}.md", f"---\norphan: true\nnosearch: true\n---\n\n# {source}\n\n`````{language}\n{text}`````\n"
      )

  def linked(self, text: str, path: str, place: str) -> str:
    """Return the text of a page with links that lead to pages of the site.

    Args:
      text: Markdown.
      path: File in the repository that its links start from.
      place: Page of the site that it becomes.
    """

    def replaced(found: re.Match[str]) -> str:
      label, target, anchor = found[1], found[2], found[3] or ""
      if not target or "://" in target or target.startswith(("mailto:", "{")):
        return found[0]
      there = os.path.normpath(PurePosixPath(path).parent / target)
      address = self._address(there)
      if address is None:
        return label[1:-1]
      return f"{label}({os.path.relpath(address, PurePosixPath(place).parent)}{anchor})"

    parts: list[str] = []
    end = 0
    for code in _FENCE.finditer(text):
      inside = code[0] if code[1][0] != ":" else _LINK.sub(replaced, code[0])
      parts += [_LINK.sub(replaced, text[end : code.start()]), inside]
      end = code.end()
    return "".join([*parts, _LINK.sub(replaced, text[end:])])

  def close(self) -> None:
    """Remove what an earlier build wrote and this one did not."""
    for path in sorted(self.folder.rglob("*"), reverse=True):
      if path.is_file() and path not in self.written:
        path.unlink()
      elif path.is_dir() and not any(path.iterdir()):
        path.rmdir()

  def _address(self, there: str) -> str | None:
    """Return the page of a file or folder of the repository; None if it has none."""
    path = ROOT / there
    if path.is_dir():
      there = f"{there}/README.md"
    if there == "README.md":
      return "index.md"
    if there in self.addresses:
      return self.addresses[there]
    if there.startswith("docs/") and path.suffix in _PICTURES:
      return there.removeprefix("docs/")
    if path.is_file() and path.suffix not in _PICTURES:
      self._sources.add(there)
      return f"source/{there}" if path.suffix in _DATA else f"source/{there}.md"
    return None


def _guides(listed: str) -> str:
  """Return contents for the pages directly below `docs` that no other contents name."""
  names = [path.stem for path in sorted((ROOT / "docs").glob("*.md"))]
  rest = [name for name in names if name != "index" and not re.search(rf"\b{name}\b", listed)]
  lines = "".join(f"../{name}\n" for name in rest)
  return f"\n```{{toctree}}\n:caption: More\n:maxdepth: 1\n:hidden:\n\n{lines}```\n" if rest else ""


def members() -> list[Path]:
  """Return the folders of all members."""
  return sorted(path.parent for kind in ("packages", "tasks") for path in ROOT.glob(f"{kind}/*/pyproject.toml"))


def _addresses() -> dict[str, str]:
  """Return the page of the site that each Markdown file of the repository becomes."""
  found = {"CONTRIBUTING.md": "contributing.md"}
  for member in members():
    for path in sorted(member.glob("*.md")):
      name = path.stem.lower()
      kinds = {"readme": f"reference/packages/{member.name}.md", "changelog": f"changelog/{member.name}.md"}
      place = kinds.get(name, f"reference/packages/{member.name}_{name}.md")
      found[path.relative_to(ROOT).as_posix()] = place
  for path in sorted((ROOT / "docs").rglob("*.md")):
    place = path.relative_to(ROOT / "docs")
    found[path.relative_to(ROOT).as_posix()] = str(place.parent / "index.md" if place.name == "README.md" else place)
  return found
