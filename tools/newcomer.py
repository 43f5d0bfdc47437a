"""Follow the first pages of the documentation in an empty environment: `python tools/newcomer.py [--python 3.13]`.

Builds wheels of all members, installs them into a fresh environment as `uv tool install` does, with HOME in an empty
folder, and types what docs/start and the first three tutorials show: files as they stand there, commands without
`uv run`. Commands that open a page run until it answers. Nothing of the clone can be imported. Prints the time and the
exit code of each command; its own exit code is 1 if one failed.
"""

import argparse
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = (
  "start/first_policy.md",
  "start/first_training.md",
  "tutorials/01_cartpole.md",
  "tutorials/02_terms.md",
  "tutorials/03_own_robot.md",
)
BLOCK = re.compile(r"```(python|bash|xml)\n(.*?)```", re.DOTALL)
FILE = re.compile(r"(?:# |<!-- )(mine/[\w.]+)")
# Small versions of commands that a newcomer leaves running.
SHORT = {
  "train": ["--env.scene.num-envs", "16", "--agent.max-iterations", "2", "--device", "cpu"],
  "evaluate": ["--eval.episodes", "2"],
}
PAGE_TIME = 1800.0


class Trial:
  """One environment with its results."""

  def __init__(self, folder: Path, python: str) -> None:
    self.home, self.place, self.python = folder / "home", folder / "work", python
    self.home.mkdir()
    self.place.mkdir()
    kept = {
      name: os.environ[name]
      for name in ("LANG", "UV_INDEX_URL", "UV_DEFAULT_INDEX", "SSL_CERT_FILE")
      if name in os.environ
    }
    cache = subprocess.run(["uv", "cache", "dir"], capture_output=True, text=True, check=True).stdout.strip()
    # Packages come from the cache of this machine; everything else is as empty as on a new one.
    self.variables = kept | {
      "HOME": str(self.home),
      "PATH": f"{self.home / 'env/bin'}:{Path(shutil.which('uv') or 'uv').parent}:/usr/bin:/bin",
      "UV_CACHE_DIR": cache,
    }
    self.failed: list[str] = []

  def run(self, words: list[str], limit: float = 1800.0) -> None:
    """Run a command to its end."""
    started = time.monotonic()
    done = subprocess.run(words, cwd=self.place, env=self.variables, capture_output=True, text=True, timeout=limit)
    self.report(words, done.returncode, time.monotonic() - started, done.stdout + done.stderr)

  def watch(self, words: list[str]) -> None:
    """Run a command that serves a page until the page answers, then interrupt it."""
    started = time.monotonic()
    log = self.place / "page.log"
    with log.open("w+") as said:
      process = subprocess.Popen(words, cwd=self.place, env=self.variables, stdout=said, stderr=subprocess.STDOUT)
      answered = False
      while process.poll() is None and not answered and time.monotonic() - started < PAGE_TIME:
        if found := re.search(r"http://[\w.]+:\d+", log.read_text(errors="replace")):
          try:
            answered = urllib.request.urlopen(found[0], timeout=5).status == 200
          except (urllib.error.URLError, TimeoutError):
            time.sleep(0.2)
        else:
          time.sleep(0.2)
      seconds = time.monotonic() - started
      process.terminate()
      process.wait(60)
    self.report(words, 0 if answered else 1, seconds, log.read_text(errors="replace"))

  def report(self, words: list[str], code: int, seconds: float, said: str) -> None:
    """Print the outcome of a command, with its last lines if it failed."""
    print(f"{'ok    ' if code == 0 else 'FAILED'} {seconds:6.1f} s  {shlex.join(words)[:110]}", flush=True)
    if code:
      self.failed.append(shlex.join(words))
      print("\n".join(f"         {line}" for line in said.splitlines()[-12:]), flush=True)

  def page(self, name: str) -> None:
    """Type what a page shows."""
    print(f"-- docs/{name}", flush=True)
    program, is_new = "", False  # blocks of a page are one program, run before the next command and at the end
    for language, code in [*BLOCK.findall((ROOT / "docs" / name).read_text(encoding="utf-8")), ("bash", "")]:
      if file := FILE.match(code):
        (self.place / file[1]).parent.mkdir(exist_ok=True)
        (self.place / file[1]).write_text(code, encoding="utf-8")
      elif language == "python":
        program, is_new = program + code, True
      elif language == "bash":
        if is_new:
          (self.place / "typed.py").write_text(program, encoding="utf-8")
          self.run(["python", "typed.py"])
          is_new = False
        for line in code.replace("\\\n", " ").splitlines():
          self.type(shlex.split(line, comments=True))

  def type(self, words: list[str]) -> None:
    """Run one line of a page."""
    words = words[2:] if words[:2] == ["uv", "run"] else words
    if not words or words[0] in ("uv", "cd", "source"):
      return
    command = words[2] if words[0] == "python" and len(words) > 2 else words[0]
    if "--video" not in words and command in ("demo", "play"):
      self.watch(words if command == "demo" else [*words, "--viewer", "browser"])
    elif "--help" in words or "--agent.max-iterations" in words:
      self.run(words)
    else:
      short = SHORT.get(command, [])
      for flag, value in zip(short[::2], short[1::2], strict=True):
        at = words.index(flag) if flag in words else len(words)
        words = [*words[:at], flag, value, *words[at + 2 :]]
      self.run(words)


def main() -> int:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--python", default="3.11", help="version or path of Python (default: %(default)s)")
  parser.add_argument("--pages", nargs="*", default=PAGES, help="pages below docs to follow")
  args = parser.parse_args()
  with tempfile.TemporaryDirectory() as folder:
    trial = Trial(Path(folder), args.python)
    wheels = Path(folder) / "wheels"
    started = time.monotonic()
    subprocess.run(
      ["uv", "build", "--quiet", "--all-packages", "--wheel", "--out-dir", str(wheels)], cwd=ROOT, check=True
    )
    print(f"       {time.monotonic() - started:6.1f} s  wheels of {len(list(wheels.glob('*.whl')))} members")
    trial.run(["uv", "venv", "--quiet", "--python", args.python, str(trial.home / "env")])
    members = [str(wheel) for wheel in sorted(wheels.glob("*.whl")) if not wheel.name.startswith("mjlab_docs")]
    trial.run(["uv", "pip", "install", "--quiet", "--python", str(trial.home / "env"), *members])
    trial.run(["python", "--version"])
    trial.run(["mjlab", "--help"])
    trial.watch(["mjlab", "demo"])
    # The one file of the clone that the tutorials read.
    shutil.copytree(ROOT / "tests" / "models", trial.place / "tests" / "models")
    for page in args.pages:
      trial.page(page)
    for line in trial.failed:
      print(f"failed: {line}")
  return 1 if trial.failed else 0


if __name__ == "__main__":
  sys.exit(main())
