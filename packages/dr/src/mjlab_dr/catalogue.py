"""The fields that can be randomised: the one table from which everything else follows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import mujoco

Kind = Literal["geom", "body", "joint"]


@dataclass(frozen=True, kw_only=True)
class Field:
  """What there is to know about one randomisable field."""

  kind: Kind
  """Whose field it is: patterns select among the names of this kind."""

  axes: tuple[str, ...]
  """Names of the components of one element; a single empty name for a scalar."""

  unit: str
  """Unit of every component."""

  minimum: float = -math.inf
  """Smallest physical value."""

  derived: tuple[str, ...] = ()
  """Fields of MjModel that follow from it through `mj_setConst`; empty when none do."""

  in_model: bool = True
  """Whether MjModel has it. One that it does not have is (number of elements,) with the default zero."""

  breaks_simple: bool = False
  """Whether it moves the inertial frame, which MuJoCo refuses for a body that it compiled as simple."""

  @property
  def needs_constants(self) -> bool:
    """Whether derived fields must be recomputed after a change."""
    return bool(self.derived)


FIELDS: dict[str, Field] = {
  "geom_friction": Field(kind="geom", axes=("sliding", "torsional", "rolling"), unit="1, m, m", minimum=0.0),
  "body_ipos": Field(
    kind="body",
    axes=("x", "y", "z"),
    unit="m",
    derived=(
      "body_invweight0",
      "dof_invweight0",
      "dof_M0",
      "tendon_invweight0",
      "actuator_acc0",
      "cam_poscom0",
      "light_poscom0",
    ),
    breaks_simple=True,
  ),
  "encoder_bias": Field(kind="joint", axes=("",), unit="rad or m", in_model=False),
}
"""Every randomisable field by its name."""

_OBJECTS = {"geom": mujoco.mjtObj.mjOBJ_GEOM, "body": mujoco.mjtObj.mjOBJ_BODY, "joint": mujoco.mjtObj.mjOBJ_JOINT}
_SIZES = {"geom": "ngeom", "body": "nbody", "joint": "njnt"}
_SCALAR_JOINTS = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))


def count(model: mujoco.MjModel, kind: Kind) -> int:
  """Number of elements of a kind."""
  return getattr(model, _SIZES[kind])


def element_names(model: mujoco.MjModel, kind: Kind) -> list[str]:
  """Names of all elements of a kind in the order of the model; one without a name is called like "(geom 3)"."""
  return [
    mujoco.mj_id2name(model, _OBJECTS[kind], i) or ("world" if kind == "body" and i == 0 else f"({kind} {i})")
    for i in range(count(model, kind))
  ]


def candidates(model: mujoco.MjModel, kind: Kind) -> list[int]:
  """Ids of the elements that a pattern may select: all geoms, bodies but the world, joints with one coordinate."""
  if kind == "body":
    return list(range(1, model.nbody))
  if kind == "joint":
    return [i for i in range(model.njnt) if int(model.jnt_type[i]) in _SCALAR_JOINTS]
  return list(range(count(model, kind)))
