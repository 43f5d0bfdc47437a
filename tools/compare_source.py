"""Tokens of the source beside those of mjlab 1.6.0, by subject: `uv run python tools/compare_source.py FOLDER`.

FOLDER holds the package `mjlab` of `pip download --no-deps mjlab==1.6.0`, unpacked. Prints a Markdown table, and the
modules without a counterpart there. `docs/source.md` has its output.
"""

import argparse
import sys
from collections.abc import Iterable
from fnmatch import fnmatchcase
from pathlib import Path
from typing import NamedTuple

from measure_source import Member, Module, members, tokens


class Subject(NamedTuple):
  """Part of both projects that does the same work."""

  members: tuple[str, ...]
  """Members of this workspace."""
  reference: tuple[str, ...]
  """Files and folders of mjlab 1.6.0."""
  new: tuple[str, ...] = ()
  """Modules and folders of the members for which mjlab 1.6.0 has no counterpart; "*" stands for the rest of a name."""


# A module that does a little more than its counterpart counts as its counterpart.
SUBJECTS = {
  "utilities": Subject(("core",), ("utils", "__init__.py"), ("io.npz", "state")),
  "actuators": Subject(("actuators",), ("actuator",), ("models.motor_design",)),
  "entities and scene": Subject(
    ("scene",),
    ("entity", "scene", "utils/spec.py", "utils/spec_config.py", "utils/xml.py", "utils/mujoco.py"),
    ("models.overlay", "models.edits"),
  ),
  "physics engine": Subject(
    ("sim",),
    ("sim", "utils/nan_guard.py"),
    (
      "native",
      "freshness",
      "warp.solver",
      "warp.collision",
      "warp.constants",
      "warp.overflow",
      "warp.buffers",
      "warp.kernel_loading",
    ),
  ),
  "sensors": Subject(("sensors",), ("sensor",)),
  "terrain": Subject(("terrain",), ("terrains", "scripts/visualize_terrain.py"), ("types.height_map",)),
  "managers": Subject(
    ("managers",),
    ("managers", "utils/noise", "utils/buffers"),
    ("observations.camera_noise", "observations.deployment", "terms.watch"),
  ),
  "environments, terms and randomisation": Subject(
    ("envs", "dr"), ("envs",), ("compiled_terms", "rehearsal", "effect", "standalone")
  ),
  "robots": Subject(("robots",), ("asset_zoo",), ()),
  "cartpole": Subject(("cartpole",), ("tasks/cartpole",), ("evaluation",)),
  "velocity": Subject(("velocity",), ("tasks/velocity",), ("evaluation", "symmetry", "sim_to_real")),
  "clips and tracking": Subject(
    ("tracking", "motions"),
    ("tasks/tracking", "scripts/csv_to_npz.py"),
    ("quality", "editing", "library", "recording", "timeline"),
  ),
  "manipulation": Subject(
    ("manipulation",), ("tasks/manipulation",), ("evaluation", "image_randomization", "distillation", "lift_objects")
  ),
  "viewers": Subject(
    ("viewer",),
    ("viewer", "utils/wrappers"),
    ("replay", "browser.training_panel", "browser.time_line", "pictures.training_video", "pictures.page_look"),
  ),
  "learning": Subject(
    ("rl",),
    ("rl",),
    (
      "offpolicy",
      "onpolicy",
      "processes",
      "bundles",
      "evaluation",
      "runs.manifest",
      "runs.encoding",
      "runs.field_types",
      "runs.references",
      "runs.process_state",
    ),
  ),
  "command line": Subject(
    ("mjlab",),
    ("scripts", "tasks"),
    (
      "new",
      "inspection",
      "cli._sweep",
      "cli.shared._sweep*",
      "cli.shared._launch",
      "cli.shared._task_help",
      "cli._sysid",
      "cli._design_excitation",
      "cli._train_actuator",
      "cli._inspect_dr",
      "cli._record_motion",
      "cli.shared._clip_preview",
      "cli._export",
      "cli._evaluate",
      "cli.shared._plots",
      "cli.shared._watching",
      "cli._new",
    ),
  ),
  "identification": Subject(("sysid",), (), ("*",)),
  "deployment": Subject(("deploy",), (), ("*",)),
}


def _is_new(member: Member, module: Module, names: Iterable[str]) -> bool:
  name = module.name.removeprefix(member.package).lstrip(".")
  return any(fnmatchcase(name, new) or name.startswith(f"{new}.") for new in names)


def reference_files(folder: Path) -> dict[Path, str]:
  """Return the subject of every file of mjlab 1.6.0; the longest path that names a file or its folder counts."""
  owners = {path: subject for subject, row in SUBJECTS.items() for path in row.reference}
  found = {}
  for file in sorted(folder.rglob("*.py")):
    parts = file.relative_to(folder).parts
    prefixes = ["/".join(parts[:length]) for length in range(len(parts), 0, -1)]
    found[file] = next((owners[prefix] for prefix in prefixes if prefix in owners), "command line")
  return found


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("folder", type=Path)
  folder = parser.parse_args().folder
  by_name = {member.name: member for member in members()}
  for row in SUBJECTS.values():
    for name in row.new:
      if not any(
        _is_new(by_name[member], module, [name]) for member in row.members for module in by_name[member].modules
      ):
        sys.exit(f"SUBJECTS: '{name}' is not a module of {' or '.join(row.members)}")
  reference = dict.fromkeys(SUBJECTS, 0)
  for file, subject in reference_files(folder).items():
    reference[subject] += tokens(Module("", file))
  if not sum(reference.values()):
    sys.exit(f"{folder}: no Python files")
  rows, listed = [], []
  for subject, row in SUBJECTS.items():
    sizes = {module: (by_name[name], tokens(module)) for name in row.members for module in by_name[name].modules}
    new = {module: size for module, (member, size) in sizes.items() if _is_new(member, module, row.new)}
    same = sum(size for _, size in sizes.values()) - sum(new.values())
    rows.append((subject, reference[subject], same, sum(new.values())))
    listed += [f"{module.name} {size}" for module, size in new.items()]
  rows.append(("total", *(sum(column) for column in list(zip(*rows, strict=True))[1:])))
  print("| subject | mjlab 1.6.0 | the same work here | without a counterpart |\n| --- | ---: | ---: | ---: |")
  for name, *numbers in rows:
    print(f"| {name} | {' | '.join(map(str, numbers))} |")
  print(f"\nwithout a counterpart: {', '.join(listed)}")


if __name__ == "__main__":
  main()
