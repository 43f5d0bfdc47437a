"""Table of all randomisable fields, written from the code: `python tools/write_catalogue.py`.

A test holds the file against what this would write.
"""

import math
from pathlib import Path

from mjlab_dr import FIELDS, Field, followers_of, needs_constants

FILE = Path(__file__).parents[1] / "packages" / "dr" / "CATALOGUE.md"

_GROUPS = {
  "*inverse weights*": ("body_invweight0", "dof_invweight0", "dof_M0", "tendon_invweight0", "actuator_acc0"),
  "*lengths*": ("tendon_length0", "actuator_length0"),
  "*cameras*": ("cam_poscom0", "cam_pos0", "cam_mat0"),
  "*lights*": ("light_poscom0", "light_pos0", "light_dir0"),
}

_DERIVED = "follows from other fields"
_LAYOUT = "is the place of buffers in memory"
_ACCURACY = "is the accuracy of the solver, not a property of the world"

LEFT_OUT: dict[str, str] = {
  **dict.fromkeys(
    (
      *("body_subtreemass", "body_invweight0", "dof_invweight0", "tendon_invweight0", "tendon_length0"),
      *("actuator_acc0", "geom_aabb", "geom_rbound", "cam_poscom0", "cam_pos0", "cam_mat0"),
      *("light_poscom0", "light_pos0", "light_dir0"),
    ),
    _DERIVED,
  ),
  **dict.fromkeys(("actuator_history", "actuator_historyadr", "sensor_history", "sensor_historyadr"), _LAYOUT),
  **dict.fromkeys((f"opt.{x}tolerance" for x in ("", "ls_", "noslip_", "ccd_", "sleep_")), _ACCURACY),
  "opt.impratio_invsqrt": "belongs to the solver, and MuJoCo Warp alone stores it in this form",
  "sensor_delay": "is a property of the reader: observation terms have a separate delay",
  "sensor_interval": "fixes how many samples a buffer holds, which is decided when the model is compiled",
  "light_type": "decides which code draws it, when the picture's context is made",
  "geom_dataid": "decides mesh, mass and bounds at once, which is what `VariantEntityCfg` of mjlab-scene is for",
}
"""Reasons, by field, why a field that MuJoCo Warp can hold per world is not randomised."""

_HEAD = """\
# Randomisable fields

Written by `tools/write_catalogue.py` from the one table in `mjlab_dr.catalogue`; every row is tested by itself against
a model recompiled with its values. Use any row as `randomize_field(field, pattern, values)`; options are one element,
`".*"`.

Operations are `absolute`, `add` and `scale`, from the compiled default every time; the table lists the default one.
Fields with a value for each degree of freedom are drawn once for a joint. Fields that *follow* get a value per world
together with the field, and are derived again after every change; "bookkeeping" is MuJoCo's own, such as bounds of
bodies.

A body is *simple* where MuJoCo's compiler finds its part of the inertia matrix diagonal and constant: a free box, or a
puck of two slides and a hinge. Both engines then store the diagonal alone, so fields that would add to the rest act
wrongly. Scenes of mjlab compile no body as simple. In other models such a body is left out of a pattern with a warning,
and refused where nothing else matches; compile it with `simple="false"` (`MjSpec.body(name).simple = False`) instead.

GROUPS
"""


def table() -> str:
  """Return the whole document."""
  groups = "\n".join(f"- {group}: {', '.join(f'`{name}`' for name in names)}" for group, names in _GROUPS.items())
  lines = [
    _HEAD.replace("GROUPS", groups),
    "| field | of | axes [unit] | admissible | operation | follows | notes |",
    "|---|---|---|---|---|---|---|",
  ]
  for name, field in FIELDS.items():
    cells = (f"`{name}`", field.kind, _axes(field), _admissible(field), field.operation, _follows(name), _notes(field))
    lines.append("| " + " | ".join(cells) + " |")
  lines += [
    "",
    "## Fields that MuJoCo Warp can hold per world, and that are not randomised",
    "",
    "| field | because it |",
    "|---|---|",
  ]
  reasons: dict[str, list[str]] = {}
  for name, reason in LEFT_OUT.items():
    reasons.setdefault(reason, []).append(f"`{name}`")
  lines += [f"| {', '.join(names)} | {reason} |" for reason, names in reasons.items()]
  return "\n".join(lines) + "\n"


def _axes(field: Field) -> str:
  units = [field.unit_of(axis) for axis in range(len(field.axes))]
  if field.axes == ("",):
    return f"[{units[0]}]"
  if len(set(units)) == 1:
    return f"{', '.join(field.axes)} [{units[0]}]"
  return ", ".join(f"{axis} [{unit}]" for axis, unit in zip(field.axes, units, strict=True))


def _admissible(field: Field) -> str:
  if field.integer:
    if field.names:
      return f"names or ids of {field.names}s"
    return "0 or 1" if field.maximum == (1.0,) else "whole, from 0"
  bounds = {field.bounds(axis) for axis in range(len(field.axes))}
  parts = []
  for lo, hi in sorted(bounds):
    if hi < math.inf:
      parts.append(f"{'above' if field.positive else 'from'} {lo:g} to {hi:g}")
    elif lo > -math.inf:
      parts.append(f"{'above' if field.positive else 'at least'} {lo:g}")
  if field.ordered:
    parts.append("lower at most upper")
  if not field.from_zero:
    parts.append("not if compiled as zero")
  if len(bounds) > 1:
    return "by axis: " + ", ".join(_bound(field, axis) for axis in range(len(field.axes)))
  return ", ".join(parts) or "any"


def _bound(field: Field, axis: int) -> str:
  lo, hi = field.bounds(axis)
  if lo == -math.inf:
    return f"{field.axes[axis]} any"
  return f"{field.axes[axis]} {'above' if field.positive else 'from'} {lo:g}" + (f" to {hi:g}" if hi < math.inf else "")


def _follows(row: str) -> str:
  field = FIELDS[row]
  names = [field.moves_with] if field.moves_with else []
  names += followers_of(row)
  cells: list[str] = []
  for group, members in _GROUPS.items():
    if set(members) <= set(names):
      cells.append(group)
      names = [name for name in names if name not in members]
  cells = [f"`{name}`" for name in names] + cells
  return ", ".join(cells) or ("bookkeeping" if needs_constants(row) else "-")


def _notes(field: Field) -> str:
  writes = "writes " + ", ".join(f"`{name}`" for name in field.fields)
  form = {
    "direction": "unit length",
    "rotation": "angles about the axes of the parent",
    "servo": writes,
    "pseudo_inertia": writes,
  }
  return "; ".join(filter(None, (field.note, form.get(field.form, ""))))


if __name__ == "__main__":
  FILE.write_text(table(), encoding="utf-8")
  print(f"wrote {FILE}")
