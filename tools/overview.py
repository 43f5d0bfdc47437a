"""Table and picture that open the benchmarks: `uv run python tools/overview.py`.

Figures of this project are read from the tables and curves in `docs/benchmarks`; those of others are in `others.json`
there, with their sources. Run it again after a figure has changed; a test holds the table against what this writes.
"""

import csv
import json
import re
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

FOLDER = Path(__file__).parents[1] / "docs" / "benchmarks"
PAGE, PICTURE = FOLDER / "README.md", FOLDER / "overview.png"
BEGIN, END = "<!-- written by tools/overview.py -->\n", "<!-- end of what tools/overview.py writes -->\n"
OURS = "this project"
RATE, SECONDS = "env steps/s", "s"
# Key, title, unit, and the file that has the figure of this project.
ROWS = (
  ("go1_flat", "A quadruped on flat ground (Go1)", RATE, "step_Mjlab-Velocity-Flat-Unitree-Go1_cuda.md"),
  ("g1_flat", "A humanoid on flat ground (G1)", RATE, "step_Mjlab-Velocity-Flat-Unitree-G1_cuda.md"),
  ("g1_rough", "A humanoid on rough ground (G1)", RATE, "step_Mjlab-Velocity-Rough-Unitree-G1_cuda.md"),
  ("g1_clip", "A humanoid that follows a clip (G1)", RATE, "step_Mjlab-Tracking-Flat-Unitree-G1_cuda.md"),
  ("g1_iteration", "One iteration of PPO, G1 on flat ground", SECONDS, "learners_g1_flat.csv"),
  ("g1_walks", "Training until a G1 walks on flat ground", SECONDS, "learners_cuda.md"),
)


class Figure(NamedTuple):
  """One measured or stated number."""

  row: str
  name: str
  value: float
  gpu: str
  measured: bool
  source: str

  def cell(self, unit: str) -> str:
    """Return the figure as a cell of the table."""
    name = "" if self.name in (OURS, "mjlab 1.6.0") else f"{self.name}: "
    number = f"{self.value / 1000:.0f} k" if unit == RATE else f"{self.value:.3g} s"
    how = "measured" if self.measured else "stated"
    return f"{name}**{number}**, {self.gpu}, {f'[{how}]({self.source})' if self.source else how}"


def figures() -> list[Figure]:
  """Return all figures: those of this project first in each row."""
  found = []
  for key, _, _, file in ROWS:
    text = (FOLDER / file).read_text(encoding="utf-8")
    value = _of_iteration(text) if file.endswith(".csv") else _of_learner(text) if key == "g1_walks" else _of_step(text)
    device = re.search(r"NVIDIA ([\w ]+),", text)
    source = "learners_cuda.md" if file.endswith(".csv") else file
    found.append(Figure(key, OURS, value, device[1] if device else "H200", True, source))
  for item in json.loads((FOLDER / "others.json").read_text(encoding="utf-8"))["figures"]:
    found.append(Figure(**{"measured": False, "source": ""} | item))
  return found


def table(found: Sequence[Figure]) -> str:
  """Return the table as Markdown."""
  lines = ["| 4096 robots | this project | mjlab 1.6.0 | others |", "|---|---|---|---|"]
  for key, title, unit, _ in ROWS:
    row = [figure for figure in found if figure.row == key]
    ours = [figure.cell(unit) for figure in row if figure.name == OURS]
    reference = [figure.cell(unit) for figure in row if figure.name == "mjlab 1.6.0"] or ["not measured"]
    others = [figure.cell(unit) for figure in row if figure.name not in (OURS, "mjlab 1.6.0")] or ["not stated"]
    lines.append(f"| {title} | {' '.join(ours)} | {' '.join(reference)} | {'; '.join(others)} |")
  return "\n".join(lines) + "\n"


def section(text: str, content: str) -> str:
  """Return the page with the table between its marks."""
  before, _, rest = text.partition(BEGIN)
  return before + BEGIN + "\n" + content + "\n" + END + rest.partition(END)[2]


def _columns(text: str) -> list[dict[str, str]]:
  """Return the rows of the first table of a Markdown file by their heads."""
  lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("|")]
  return [dict(zip(lines[0], line, strict=False)) for line in lines[2:]]


def _of_step(text: str) -> float:
  return next(float(row["env_steps_per_s"]) for row in _columns(text) if row["worlds"] == "4096")


def _of_iteration(text: str) -> float:
  """Return the median of the second half of a training."""
  rows = [row for row in csv.DictReader(text.splitlines()) if row["run"] == "PPO, fused solver, seed 1"]
  return statistics.median(float(row["collect_s"]) + float(row["learn_s"]) for row in rows[len(rows) // 2 :])


def _of_learner(text: str) -> float:
  """Return the median of the seeds' times; a seed that did not get there counts as the longest."""
  tasks = ("G1 flat", "G1 flat, after the redesign")
  targets = [row["target [s]"] for row in _columns(text) if row["task"] in tasks and row["learner"] == "FastSAC"]
  return statistics.median(float(word) if word.isdigit() else float("inf") for word in targets)


def draw(found: Sequence[Figure]) -> None:
  """Draw the rates as bars."""
  import matplotlib.pyplot as plt

  rows = [(key, title) for key, title, unit, _ in ROWS if unit == RATE]
  counts = [sum(figure.row == key for figure in found) for key, _ in rows]
  figure, axes = plt.subplots(
    len(rows), 1, figsize=(8, 0.48 * sum(counts) + 2.4), height_ratios=counts, sharex=True, layout="constrained"
  )
  for axis, (key, title) in zip(axes, rows, strict=True):
    bars = [item for item in found if item.row == key]
    for place, item in enumerate(bars):
      color = "#1f77b4" if item.name == OURS else "#7f7f7f" if item.measured else "white"
      axis.barh(
        place,
        item.value / 1000,
        0.72,
        color=color,
        hatch="" if item.measured else "///",
        edgecolor="#555",
        linewidth=0.7,
      )
      axis.text(item.value / 1000, place, f"  {item.value / 1000:.0f} k", va="center", fontsize=10)
    axis.set_yticks(range(len(bars)), [f"{item.name}, {item.gpu}" for item in bars], fontsize=10)
    axis.set_title(title, loc="left", fontsize=11, fontweight="bold")
    axis.invert_yaxis()
    axis.spines[["top", "right"]].set_visible(False)
  axes[-1].set_xlim(0, 1.12 * max(item.value / 1000 for item in found if item.value > 1000))
  figure.supxlabel(
    "environment steps per second [thousands], 4096 robots\nhatched: stated by the authors, not measured here",
    fontsize=10,
  )
  figure.savefig(PICTURE, dpi=110)


def main() -> None:
  found = figures()
  PAGE.write_text(section(PAGE.read_text(encoding="utf-8"), table(found)), encoding="utf-8")
  draw(found)
  print(f"wrote the table of {PAGE} and {PICTURE}")


if __name__ == "__main__":
  main()
