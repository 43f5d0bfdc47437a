"""Command `docs`: build the site, check it, and serve it on this machine."""

import argparse
import functools
import http.server
import shutil
import sys
import time
from collections.abc import Sequence

from sphinx.cmd.build import build_main

from mjlab_docs import api, check, commands, llms, pages, tasks

FOLDER = pages.ROOT / "build" / "docs"


def main(argv: Sequence[str] | None = None) -> int:
  """Build the site; return the exit code."""
  parser = argparse.ArgumentParser(prog="docs", description="Build the documentation and serve it on this machine.")
  parser.add_argument("--check", action="store_true", help="build with warnings as errors, check links, do not serve")
  parser.add_argument("--port", type=int, default=8000, help="port of the server (default: %(default)s)")
  options = parser.parse_args(argv)
  started = time.monotonic()
  source, built = FOLDER / "source", FOLDER / "html"
  site = pages.Site(source)
  site.lay_out()
  homes = api.write(site)
  commands.write(site)
  tasks.write(site, homes)
  site.close()
  if options.check:
    shutil.rmtree(built, ignore_errors=True)
  strict = ["--fail-on-warning", "--keep-going"] if options.check else []
  code = build_main([*strict, "--quiet", "--jobs", "auto", "-d", str(FOLDER / "doctrees"), str(source), str(built)])
  llms.write(source, built)
  found = check.problems(built)
  for line in found:
    print(line, file=sys.stderr)
  print(f"{len(list(built.rglob('*.html')))} pages in {built} after {time.monotonic() - started:.0f} s")
  if options.check or code:
    return code or bool(found)
  return _serve(str(built), options.port)


def _serve(folder: str, port: int) -> int:
  handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=folder)
  with http.server.ThreadingHTTPServer(("127.0.0.1", port), handler) as server:
    print(f"open http://127.0.0.1:{server.server_address[1]} (Ctrl-C ends)", flush=True)
    try:
      server.serve_forever()
    except KeyboardInterrupt:
      print()
  return 0
