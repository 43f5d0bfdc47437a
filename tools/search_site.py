"""Search the built site for twenty questions: `uv run docs --check && uv run python tools/search_site.py`.

The questions, the words to search and the pages that answer are in `docs/findability.md`; this prints the table again
with the place of each page among the results, and fails if a page is not found. It needs Chromium.
"""

import functools
import http.server
import re
import shutil
import sys
import threading
from pathlib import Path
from urllib.parse import quote_plus

from playwright.sync_api import Page, sync_playwright

ROOT = Path(__file__).parents[1]
BUILT = ROOT / "build" / "docs" / "html"
DOCUMENT = ROOT / "docs" / "findability.md"
ROW = re.compile(r"^\| (.+?) \| `(.+?)` \| \[(.+?)\]\((.+?)\) \| \d+ \|$", re.MULTILINE)


class Quiet(http.server.SimpleHTTPRequestHandler):
  """Server of files that logs nothing."""

  def log_message(self, format: str, *args: object) -> None:
    pass


def results(page: Page, address: str, words: str) -> list[str]:
  """Return the pages found, best first, without repeats."""
  page.goto(f"{address}/search.html?q={quote_plus(words)}")
  page.wait_for_function("/found|did not match/.test(document.querySelector('.search-summary')?.textContent ?? '')")
  page.wait_for_load_state("networkidle")
  links = [link.get_attribute("href") or "" for link in page.query_selector_all("ul.search li > a")]
  return list(dict.fromkeys(re.split(r"[?#]", link)[0] for link in links))


def main() -> int:
  server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(BUILT)))
  threading.Thread(target=server.serve_forever, daemon=True).start()
  address = f"http://127.0.0.1:{server.server_address[1]}"
  missing = 0
  print("| question | words | page | place |\n|---|---|---|---:|")
  with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
    page = browser.new_page()
    page.set_default_timeout(300_000)
    for question, words, title, target in ROW.findall(DOCUMENT.read_text(encoding="utf-8")):
      found = results(page, address, words)
      name = re.sub(r"\.md(#.*)?$", ".html", target)
      place = found.index(name) + 1 if name in found else 0
      missing += place == 0
      print(f"| {question} | `{words}` | [{title}]({target}) | {place} |")
  server.shutdown()
  return 1 if missing else 0


if __name__ == "__main__":
  sys.exit(main())
