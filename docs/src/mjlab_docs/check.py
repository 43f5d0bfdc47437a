"""Check of a built site: links and anchors lead somewhere, and nothing is loaded from elsewhere."""

from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

_LOADS = {"script": "src", "img": "src", "source": "src", "video": "src", "iframe": "src", "link": "href"}
_ELSEWHERE = {"canonical", "author", "license"}


class _Page(HTMLParser):
  """Links, loaded files and anchors of a page."""

  def __init__(self, path: Path) -> None:
    super().__init__()
    self.links: list[str] = []
    self.loads: list[str] = []
    self.anchors: set[str] = set()
    self.feed(path.read_text(encoding="utf-8"))

  def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
    values = {name: value for name, value in attrs if value}
    self.anchors |= {values[name] for name in ("id", "name") if name in values}
    if tag == "a" and "href" in values:
      self.links.append(values["href"])
    elif tag in _LOADS and _LOADS[tag] in values and values.get("rel") not in _ELSEWHERE:
      self.loads.append(values[_LOADS[tag]])


def problems(built: Path) -> list[str]:
  """Return one line for each link that leads nowhere and each file loaded from another host."""
  pages = {path.resolve(): _Page(path) for path in sorted(built.rglob("*.html")) if "_static" not in path.parts}
  found = []
  for path, page in pages.items():
    name = path.relative_to(built.resolve())
    if name.parts[0] == "_modules":  # Sphinx writes these; their links back may name objects that it found itself.
      continue
    for address in page.loads:
      target = urlsplit(address)
      if target.netloc or target.scheme not in ("", "data"):
        found.append(f"{name}: loads {address}")
      elif target.path and not (path.parent / unquote(target.path)).exists():
        found.append(f"{name}: {address} does not exist")
    for address in page.links:
      target = urlsplit(address)
      if target.scheme or target.netloc:
        continue
      there = (path.parent / unquote(target.path)).resolve() if target.path else path
      if not there.exists():
        found.append(f"{name}: {address} does not exist")
      elif target.fragment and there in pages and unquote(target.fragment) not in pages[there].anchors:
        found.append(f"{name}: {address} has no such anchor")
  for sheet in sorted(built.rglob("*.css")):
    text = sheet.read_text(encoding="utf-8")
    found += [
      f"{sheet.relative_to(built)}: loads from {host}"
      for host in ("url(http", "url('http", 'url("http')
      if host in text
    ]
    if "@import" in text and "@import url(http" in text.replace('"', "").replace("'", ""):
      found.append(f"{sheet.relative_to(built)}: imports from another host")
  return found
