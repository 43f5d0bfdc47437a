"""Check of a built site: links and anchors lead somewhere, and nothing is loaded from elsewhere."""

import html
import re
from pathlib import Path
from urllib.parse import unquote, urlsplit

_LOADS = {"script": "src", "img": "src", "source": "src", "video": "src", "iframe": "src", "link": "href"}
# Opening tags with values in quotes, as Sphinx writes them; quicker than a parser of everything.
_TAG = re.compile(r"<([a-z]\w*)((?:\s+[\w:@-]+(?:=(?:\"[^\"]*\"|'[^']*'))?)+)\s*/?>")
_VALUE = re.compile(r'([\w:-]+)="([^"]*)"')
_ANCHOR = re.compile(r'\bid="([^"]+)"')
_ELSEWHERE = {"canonical", "author", "license"}


class _Page:
  """Links, loaded files and anchors of a page."""

  def __init__(self, path: Path) -> None:
    self.links: list[str] = []
    self.loads: list[str] = []
    self.anchors: set[str] = set()
    for tag, inside in _TAG.findall(path.read_text(encoding="utf-8")):
      values = {name: html.unescape(value) for name, value in _VALUE.findall(inside)}
      self.anchors |= {values[name] for name in ("id", "name") if values.get(name)}
      if tag == "a" and values.get("href"):
        self.links.append(values["href"])
      elif values.get(_LOADS.get(tag, "")) and values.get("rel") not in _ELSEWHERE:
        self.loads.append(values[_LOADS[tag]])


def problems(built: Path) -> list[str]:
  """Return one line for each link that leads nowhere and each file loaded from another host."""
  files = [path for path in sorted(built.resolve().rglob("*.html")) if "_static" not in path.parts]
  # Sphinx writes the pages of sources; their links back may name objects that it found itself, so only anchors count.
  sources = {path for path in files if path.relative_to(built.resolve()).parts[0] == "_modules"}
  pages = {path: _Page(path) for path in files if path not in sources}
  anchors = {path: page.anchors for path, page in pages.items()}
  anchors |= {path: set(_ANCHOR.findall(path.read_text(encoding="utf-8"))) for path in sources}
  found = []
  for path, page in pages.items():
    name = path.relative_to(built.resolve())
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
      elif target.fragment and there in anchors and unquote(target.fragment) not in anchors[there]:
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
