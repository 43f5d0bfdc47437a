"""`inspect-dr TASK [flags]`: what the events of a task do, as a table and a picture."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mjlab.cli._config_flags import replaced
from mjlab.cli._errors import UsageError
from mjlab.cli._task_command import build_env, run_with_task

if TYPE_CHECKING:
  from mjlab_rl import TaskCfg

  from mjlab.inspection import EventReport, InertiaReport


@dataclasses.dataclass(kw_only=True)
class Arguments:
  """All that can be given after the task."""

  num_envs: int = 512
  """Worlds to draw in."""
  device: str = "cpu"
  """Where to draw: cpu, cuda:0, or auto for a GPU where there is one."""
  seed: int = 0
  """Seed of the draws."""
  png: str | None = None
  """Picture of distributions, total mass and inertia ellipsoids: FILE.png."""
  force: bool = False
  """Overwrite the picture."""
  traceback: bool = False
  """Show where an error came from."""
  env: Any = None
  """Configuration of the environment."""


_PURPOSE = """\
Fires every event of a task once in many worlds and shows what was drawn beside what was asked for, the state that each
event changes, and the total mass. Says so in capitals where an event does nothing, or not what was asked.
Exit codes: 0 done, 1 a draw does nothing or is not as asked, 2 wrong usage."""


def run(arguments: list[str]) -> int:
  """Inspect one task; returns 1 if a draw does nothing, or not what was asked."""
  return run_with_task("inspect-dr", arguments, _inspect, Arguments, purpose=_PURPOSE)


def _inspect(name: str, task: "TaskCfg[Any]", given: list[str]) -> int:
  from mjlab import making
  from mjlab.cli._flag_parser import parse

  wanted = parse(Arguments(env=task.env), given)
  if wanted.num_envs < 2:
    raise UsageError(f"--num-envs is {wanted.num_envs}; draws are compared over at least 2 worlds")
  picture = None if wanted.png is None else Path(wanted.png)
  if picture is not None:
    _check_picture(picture, wanted.force)
  from mjlab.inspection import inspect_events, inspect_inertia, table

  device = making.resolve_device(wanted.device)
  cfg = replaced(replaced(wanted.env, ("scene", "num_envs"), wanted.num_envs), ("seed",), wanted.seed)
  env = build_env(task, cfg, device)
  try:
    reports = inspect_events(env)
    inertia = inspect_inertia(env)
    print(f"{name}: {env.num_envs} worlds on {device}, one draw each")
    print(table(reports, inertia))
    if picture is not None:
      draw(reports, inertia, name, picture)
      print(f"wrote {picture}")
  finally:
    env.close()
  wrong = any(axis.verdict != "as asked" for report in reports for axis in report.axes)
  return 1 if wrong else 0


def _check_picture(path: Path, force: bool) -> None:
  if path.suffix.lower() != ".png":
    raise UsageError(f"--png: {path} does not end in .png")
  if path.is_dir():
    raise UsageError(f"--png: {path} is a folder")
  if path.exists() and not force:
    raise UsageError(f"--png: {path} exists; --force overwrites it")
  if not path.absolute().parent.is_dir():
    raise UsageError(f"--png: there is no directory {path.absolute().parent}")


def draw(reports: "list[EventReport]", inertia: "InertiaReport", title: str, path: Path) -> None:
  """Draws a panel for every axis, every entity's mass, and every body whose inertia differs; at most 40."""
  from matplotlib.backends.backend_agg import FigureCanvasAgg
  from matplotlib.figure import Figure

  axes = [(report, axis) for report in reports for axis in report.axes]
  panels: list[Any] = [lambda panel, r=report, a=axis: _draw_axis(panel, r, a) for report, axis in axes]
  panels += [lambda panel, n=name: _draw_mass(panel, n, inertia) for name in inertia.masses]
  panels += [lambda panel, n=name: _draw_ellipsoids(panel, n, inertia) for name in inertia.bodies]
  left_out = max(0, len(panels) - 40)
  panels = panels[:40]
  columns = min(5, max(1, len(panels)))
  lines = -(-len(panels) // columns) or 1
  figure = Figure(figsize=(3.4 * columns, 2.7 * lines + 0.5), layout="constrained")
  FigureCanvasAgg(figure)
  grid = figure.subplots(lines, columns, squeeze=False).ravel()
  for panel, paint in zip(grid, panels, strict=False):
    paint(panel)
  for panel in grid[len(panels) :]:
    panel.set_axis_off()
  more = f" ({left_out} more panels left out)" if left_out else ""
  figure.suptitle(f"{title}: grey as asked, blue as drawn{more}")
  # Through a file of its own, so that a picture is there whole or not at all.
  part = path.with_name(path.name + ".part")
  try:
    figure.savefig(part, dpi=100, format="png")
    part.replace(path)
  finally:
    part.unlink(missing_ok=True)


_BLUE, _GREY = "#1b6ca8", "#c9ced3"


def _draw_axis(panel: Any, report: "EventReport", axis: Any) -> None:
  import numpy as np
  import torch
  from mjlab_dr import LogUniform

  generator = torch.Generator().manual_seed(0)
  asked = axis.asked.sample((20_000,), generator=generator, device=torch.device("cpu"), dtype=torch.float64).numpy()
  drawn = axis.drawn.double().cpu().numpy()
  is_log = isinstance(axis.asked, LogUniform)
  if is_log:
    asked, drawn = np.log10(asked), np.log10(drawn[drawn > 0.0])
  lo, hi = (
    min(asked.min(), *drawn[:1], drawn.min(initial=asked.min())),
    max(asked.max(), drawn.max(initial=asked.max())),
  )
  span = {"bins": 25, "range": (lo, hi if hi > lo else lo + 1e-9), "density": True}
  panel.hist(asked, color=_GREY, **span)
  if drawn.size:
    panel.hist(drawn, color=_BLUE, histtype="step", linewidth=1.5, **span)
  colour = "black" if axis.verdict == "as asked" else "#c0392b"
  what = f"{axis.field} {axis.axis}".strip()
  panel.set_title(f"{report.name} ({report.mode})\n{what}: {axis.verdict}", fontsize=8, color=colour)
  label = {"add": "added", "scale": "factor", "absolute": "value"}[axis.operation] + f" [{axis.unit}]"
  panel.set_xlabel(f"{label}, logarithm to base 10" if is_log else label, fontsize=8)
  _plain(panel)


def _draw_mass(panel: Any, name: str, inertia: "InertiaReport") -> None:
  mass = inertia.masses[name].double().cpu().numpy()
  panel.hist(mass, bins=40, color=_BLUE)
  panel.axvline(inertia.compiled[name], color="black", linestyle=":", linewidth=1)
  panel.set_title(f"total mass of {name}", fontsize=8)
  panel.set_xlabel("[kg]", fontsize=8)
  _plain(panel)


def _draw_ellipsoids(panel: Any, name: str, inertia: "InertiaReport") -> None:
  """Ellipsoids of uniform density with a body's inertia, seen along y; the compiled one in black."""
  import torch
  from matplotlib.patches import Ellipse
  from mjlab_core import matrix_from_quat

  com, moments, quat = (part[:31].double().cpu() for part in inertia.bodies[name])
  # Semi-axes squared are five times the second moments per mass.
  squares = 5.0 * (0.5 * moments.sum(-1, keepdim=True) - moments).clamp_min(0.0)
  axes = matrix_from_quat(quat)
  shadow = ((axes * squares.unsqueeze(-2)) @ axes.mT)[:, [0, 2]][:, :, [0, 2]]
  values, vectors = torch.linalg.eigh(shadow)
  for i in reversed(range(len(com))):
    angle = float(torch.rad2deg(torch.atan2(vectors[i, 1, 1], vectors[i, 0, 1])))
    height, width = (2.0 * values[i].clamp_min(0.0).sqrt()).tolist()
    style = {"edgecolor": _BLUE, "alpha": 0.35} if i else {"edgecolor": "black", "linewidth": 1.5}
    panel.add_patch(Ellipse((float(com[i, 0]), float(com[i, 2])), width, height, angle=angle, fill=False, **style))
  panel.autoscale_view()
  panel.set_aspect("equal", adjustable="datalim")
  panel.set_title(f"{name}: inertia ellipsoids, 30 worlds", fontsize=8)
  panel.set_xlabel("x [m]; upwards z [m]", fontsize=8)
  panel.tick_params(labelsize=7)


def _plain(panel: Any) -> None:
  panel.set_yticks([])
  panel.tick_params(labelsize=7)
  panel.locator_params(axis="x", nbins=6)
  panel.spines[["top", "right", "left"]].set_visible(False)
