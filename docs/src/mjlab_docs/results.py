"""Film, learning curve and scores of a task, from the pictures and benchmarks of the repository."""

import json
import re
from collections.abc import Iterator

from mjlab.demos import shipped

from mjlab_docs.pages import ROOT

BENCHMARKS = ROOT / "docs" / "benchmarks"
# Curve of each task that was trained, page of its scores, and first cells of the rows there.
RESULTS = {
  "Mjlab-Cartpole-Swingup": ("cartpole_swingup_cpu.png", None, ""),
  "Mjlab-Velocity-Flat-Unitree-Go1": ("go1_flat_gpu.png", "evaluate_go1_demo_cpu.md", r"all"),
  "Mjlab-Velocity-Flat-Unitree-G1": ("g1_flat_gpu.png", None, ""),
  "Mjlab-Velocity-Rough-Unitree-Go1": ("go1_rough_gpu.png", "evaluate_gpu.md", r"Go1, \d+ iterations"),
  "Mjlab-Velocity-Rough-Unitree-G1": ("g1_rough_gpu.png", "evaluate_gpu.md", r"G1, \d+ iterations"),
  "Mjlab-Tracking-Flat-Unitree-G1": ("g1_tracking_gpu.png", "evaluate_gpu.md", r"800"),
  "Mjlab-Lift-Cube-Yam": ("lift_gpu.png", "evaluate_gpu.md", r"1332 iterations"),
  "Mjlab-Lift-Cube-Yam-Depth": ("lift_vision_gpu.png", "evaluate_gpu.md", r"depth"),
  "Mjlab-Lift-Cube-Yam-Rgb": ("lift_vision_gpu.png", "evaluate_gpu.md", r"colours"),
  "Mjlab-Lift-Cube-Yam-Depth-Distill": ("lift_vision_gpu.png", "evaluate_gpu.md", r"the same, 1446"),
  "Mjlab-Lift-Cube-Yam-Rgb-Distill": ("lift_vision_gpu.png", "evaluate_gpu.md", r"the same, 1109"),
}


def films() -> dict[str, tuple[str, str]]:
  """Return name and film of the policies that ship, by task; the film is a path below `docs`."""
  found = {}
  for name, folder in shipped().items():
    film = f"pictures/films/{name}.webp"
    if (ROOT / "docs" / film).is_file():
      description = folder / "bundle.json"
      file = description if description.is_file() else folder / "manifest.json"
      found[json.loads(file.read_text(encoding="utf-8"))["task"]] = (name, film)
  return found


def scores(page: str, row: str) -> list[str]:
  """Return head and matching rows of the first table of a page that has a row with such a first cell."""
  head: list[str] = []
  found: list[str] = []
  for line in (BENCHMARKS / page).read_text(encoding="utf-8").splitlines():
    if not line.startswith("|"):
      if found:
        break
      head = []
    elif len(head) < 2:
      head.append(line)
    elif re.fullmatch(row, line.split("|")[1].strip()):
      found.append(line)
  return [*head, *found] if found else []


def write(task: str) -> Iterator[str]:
  """Yield the lines for the page of a task."""
  if task in (known := films()):
    name, film = known[task]
    yield f"![A policy of this task that ships](../../{film})\n"
    yield f"The policy comes with mjlab: `uv run demo --task {name}` shows it.\n"
  if task not in RESULTS:
    return
  curve, page, row = RESULTS[task]
  yield "## Curve and scores\n"
  yield f"![Learning curve](../../benchmarks/{curve})\n"
  if page is not None and (table := scores(page, row)):
    yield from table
    yield f"\nMeans with 95 % intervals; [how they were measured](../../benchmarks/{page}).\n"
