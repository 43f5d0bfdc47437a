"""Forms of the site for language models: each page as Markdown, and `llms.txt`, which lists them."""

import json
import re
from pathlib import Path

_DIRECTIVE = re.compile(r"^(:{3,}|`{3,})\{([\w:-]+)\} ?(.*)$")
_ROLE = re.compile(r"\{[\w:]+\}`(?:([^`<]+?) ?<[^>]+>|([^`]+))`")


def write(source: Path, built: Path) -> None:
  """Write `PAGE.md` beside each `PAGE.html`, and `llms.txt`."""
  lists: dict[str, list[str]] = {}
  for path in sorted(source.rglob("*.md")):
    place = path.relative_to(source)
    text = plain(path.read_text(encoding="utf-8"))
    target = built / place
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(text, encoding="utf-8")
    title, first = _summary(text)
    section = place.parts[0] if len(place.parts) > 1 else "Pages"
    if section != "source":
      lists.setdefault(section, []).append(f"- [{title}]({place.as_posix()}){': ' + first if first else ''}")
  lines = [
    "# mjlab",
    "",
    "> GPU-accelerated robot learning from small composable parts: MuJoCo, MuJoCo Warp and PyTorch.",
    "",
  ]
  for section, pages in sorted(lists.items(), key=lambda item: (item[0] != "Pages", item[0])):
    lines += [f"## {section.replace('_', ' ').capitalize()}", "", *pages, ""]
  (built / "llms.txt").write_text("\n".join(lines), encoding="utf-8")


def plain(text: str) -> str:
  """Return MyST as plain Markdown: objects become headings, other directives their contents."""
  kept: list[str] = []
  inside: list[tuple[str, str]] = []  # fences of open directives, and their names
  options = False
  code = ""
  for line in text.removeprefix("---\norphan: true\nnosearch: true\n---\n").splitlines():
    if code:
      code = "" if line.rstrip() == code else code
      kept.append(line)
      continue
    found = _DIRECTIVE.match(line)
    if found:
      name = found[2].removeprefix("py:")
      inside.append((found[1], name))
      options = True
      if found[2].startswith("py:") and name not in ("module", "currentmodule"):
        level = "###" if name in ("class", "function", "data", "exception") else "####"
        kept += ["", f"{level} {name} `{found[3]}`"]
      elif found[3] and name not in ("toctree", "module"):
        kept.append(f"**{found[3]}**")
      continue
    if inside and line.rstrip() == inside[-1][0]:
      inside.pop()
      continue
    if inside and options and line.startswith(":") and not line.startswith(":::"):
      option = re.match(r":(type|value): (.*)", line)
      if option:
        kept.append(f"- {option[1]}: `{json.loads(option[2])}`")
      continue
    options = options and not line.strip()
    if inside and inside[-1][1] == "toctree":
      continue
    if fence := re.match(r"^(`{3,}|~{3,})", line):
      code = fence[1]
    kept.append(_ROLE.sub(lambda role: f"`{role[1] or role[2]}`", line))
  return re.sub(r"\n{3,}", "\n\n", "\n".join(kept)).strip() + "\n"


def _summary(text: str) -> tuple[str, str]:
  """Return the title of a page and the first sentence of its first paragraph."""
  title = re.search(r"^# (.+)$", text, re.MULTILINE)
  paragraphs = (" ".join(part.split()) for part in text.split("\n\n"))
  first = next((part for part in paragraphs if part.lstrip("*")[:1].isalnum()), "")
  sentence = re.match(r".*?[.:](?= |$)", first)
  return title[1] if title else "", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", sentence[0] if sentence else first).rstrip(
    ":"
  )
