"""Row type of the catalogue, and the elements of a model that a row may select."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from typing import Literal

import mujoco
from mjlab_core.mujoco import model_fields

Kind = Literal[
  "option",
  "body",
  "joint",
  "geom",
  "site",
  "camera",
  "light",
  "material",
  "tendon",
  "pair",
  "equality",
  "actuator",
  "target",
]
Operation = Literal["absolute", "add", "scale"]
Form = Literal["plain", "direction", "rotation", "intrinsics", "servo", "pseudo_inertia"]


@dataclass(frozen=True)
class Field:
  """One randomisable field."""

  unit: str = "1"
  """Unit of every axis, one for all or separated by commas."""

  _: KW_ONLY

  kind: Kind = "option"
  """Kind of its elements: patterns select among the names of this kind."""

  axes: tuple[str, ...] = ("",)
  """Names of the numbers drawn for one element; a single empty name for a scalar."""

  minimum: tuple[float, ...] = (-math.inf,)
  """Smallest admissible value, one for all axes or one each."""

  maximum: tuple[float, ...] = (math.inf,)
  """Largest admissible value, likewise."""

  positive: bool = False
  """True if the minimum itself is not admissible."""

  ordered: bool = False
  """True if the first axis must not exceed the second."""

  integer: bool = False
  """True for a choice rather than a quantity: it is only replaced, and only by whole numbers."""

  names: Kind | Literal["texture"] | None = None
  """Kind of the elements that the numbers of a choice are ids of, so that names can be given."""

  form: Form = "plain"
  """`direction`: written with unit length. `rotation`: axes are angles about the parent's x, y and z, written as a
  quaternion. `intrinsics`: written with the field of view that follows. `servo`: written as gain and, negated, as the
  feedback on position. `pseudo_inertia`: the ten log-Cholesky parameters, written as the `fields` of a body."""

  fields: tuple[str, ...] = ()
  """Fields of MjModel that it writes; empty for the field with its name."""

  moves_with: str = ""
  """Field that moves by the same amount, so that the distance between the two stays."""

  at: Literal["element", "dof", "qpos", "ctrl", "out"] = "element"
  """Rows of an element: its own, or those of its degrees of freedom, coordinates, controls or outputs, which share a
  draw."""

  from_zero: bool = True
  """True if an element compiled with zeros only can get a value; engines leave out parts that are off."""

  operation: Operation = "absolute"
  """Default operation of a draw."""

  in_model: bool = True
  """True if MjModel has it. Others are (number of elements,)."""

  note: str = ""
  """Note for users."""

  @property
  def width(self) -> int:
    """Number of values of one element in its field."""
    return 4 if self.form == "rotation" else len(self.axes)

  def bounds(self, axis: int) -> tuple[float, float]:
    """Return the smallest and largest admissible value of an axis."""
    return self.minimum[axis % len(self.minimum)], self.maximum[axis % len(self.maximum)]

  def unit_of(self, axis: int) -> str:
    """Return the unit of an axis."""
    units = self.unit.split(", ")
    return units[axis % len(units)]


def element_names(model: mujoco.MjModel, kind: str) -> list[str]:
  """Return the names of all elements of a kind, in the order of the model; without a name it is "(geom 3)"."""
  names = ["option"] if kind == "option" else model_fields.element_names(model, kind)
  return [name or f"({kind} {i})" for i, name in enumerate(names)]


def rows(model: mujoco.MjModel, field: Field, element: int) -> range:
  """Return the rows of an element in its field, as `Field.at` says."""
  if field.at == "element":
    return range(element, element + 1)
  if field.at == "dof":
    first, number = model.jnt_dofadr[element], (model.dof_jntid == element).sum()
  elif field.at == "qpos":
    # Only joints of one coordinate have a value that can be moved along a line.
    first, number = model.jnt_qposadr[element], 1
  elif field.at == "ctrl":
    first, number = model.actuator_ctrladr[element], model.actuator_ctrlnum[element]
  else:
    first, number = model.actuator_outadr[element], model.actuator_outnum[element]
  return range(int(first), int(first) + int(number))
