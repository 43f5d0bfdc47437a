"""Robot from a model file: read, reduced to the robot, every element named."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import mujoco
from mjlab_core import MjlabError, UsageError, printable
from mjlab_core.io.files import reading
from mjlab_core.names import match_values
from mjlab_scene import EntityCfg

Base = Literal["file", "floating", "fixed"]

JOINT_KINDS = {mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE}


@dataclass(kw_only=True)
class RobotModel:
  """Spec of a robot with the actuators and keyframes of its file."""

  spec: mujoco.MjSpec
  source: str
  """Name of the file, safe to print."""
  is_floating: bool
  notes: list[str] = field(default_factory=list)
  """Lines for the report: changes and guesses."""

  @property
  def joints(self) -> list[mujoco.MjsJoint]:
    """Hinges and slides, in the model's order."""
    return [joint for joint in self.spec.joints if joint.type in JOINT_KINDS]

  def compiled(self) -> mujoco.MjModel:
    """Compile a copy with a plane as its first geom."""
    spec = self.spec.copy()
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1.0, 1.0, 1.0])
    return spec.compile()

  def numbers(
    self, given: Sequence[str], flag: str, form: str, most: int = 1, above: float = -math.inf
  ) -> dict[str, list[float]]:
    """Return the numbers of joints that a flag gives as PATTERN=NUMBER,...

    Args:
      given: Words after the flag.
      flag: Name of the flag.
      form: Form of a word, for the message.
      most: Largest number of numbers of a joint.
      above: Limit that all numbers exceed.

    Raises:
      UsageError: A word has another form.
      UnknownNameError: A pattern matches no joint.
    """
    wanted: dict[str, list[float]] = {}
    for text in given:
      name, _, values = text.rpartition("=")
      try:
        wanted[name] = [float(value) for value in values.split(",")]
      except ValueError:
        wanted[name] = []
      if not 1 <= len(wanted[name]) <= most or not all(above < number < math.inf for number in wanted[name]):
        raise UsageError(f"{flag}: {text!r} must be {form}")
    _, names, numbers = match_values(wanted, [joint.name for joint in self.joints], what="joint", owner=flag)
    return dict(zip(names, numbers, strict=True))


def read_robot_model(path: Path, base: Base) -> RobotModel:
  """Read an MJCF or URDF file.

  Args:
    path: The file.
    base: "file" takes the base of an MJCF; the base of a URDF floats if two or more chains of joints end in its links.

  Raises:
    FileError: There is no such file, or MuJoCo cannot read or compile it.
    MjlabError: It does not hold exactly one robot with joints.
  """
  with reading("robot", path):
    spec = mujoco.MjSpec.from_file(str(path))
    spec.memory = -1
    spec.copy().compile()
  model = RobotModel(spec=spec, source=printable(path.name), is_floating=False)
  model.notes += _keep_only_the_robot(model)
  _set_base(model, base, is_urdf=path.suffix.lower() == ".urdf")
  # Entities name all elements.
  try:
    model.spec = EntityCfg(spec_fn=lambda: spec).build("robot").spec
    model.compiled()
  except ValueError as error:
    raise MjlabError(f"{path}: {printable(' '.join(str(error).split())).removeprefix('entity ')}") from error
  return model


def _keep_only_the_robot(model: RobotModel) -> list[str]:
  """Remove geoms, cameras and lights of the world; return a note about them."""
  spec = model.spec
  roots = spec.worldbody.bodies
  if len(roots) != 1:
    names = ", ".join(f"'{printable(body.name)}'" for body in roots[:8]) or "none"
    raise MjlabError(f"{model.source}: expected one body at the top level, the robot; there are: {names}")
  geoms = len(spec.worldbody.geoms)
  for element in [*spec.worldbody.geoms, *spec.worldbody.cameras, *spec.lights]:
    spec.delete(element)
  return [f"left out {geoms} geoms of the world, such as a floor"] if geoms else []


def _set_base(model: RobotModel, base: Base, *, is_urdf: bool) -> None:
  root = model.spec.worldbody.bodies[0]
  free = [joint for joint in root.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
  floats = bool(free)
  if base != "file":
    floats = base == "floating"
  elif is_urdf and not floats:
    floats = len(last_links(model.spec)) > 1
    model.notes.append(f"the base is a guess from the URDF: {'floating' if floats else 'fixed'} (--base changes it)")
  model.is_floating = floats
  if floats == bool(free):
    return
  if floats:
    root.add_freejoint()
  # Keyframes of the file have another length.
  for element in [*free, *model.spec.keys]:
    model.spec.delete(element)


def last_links(spec: mujoco.MjSpec) -> list[mujoco.MjsBody]:
  """Return the bodies with joints below which there are no joints, in the model's order."""

  def moving(joints: list[mujoco.MjsJoint]) -> int:
    return sum(joint.type in JOINT_KINDS for joint in joints)

  return [body for body in spec.bodies if moving(body.joints) == moving(body.find_all("joint")) > 0]


def pattern(name: str) -> str:
  """Return a pattern that matches a name only; a usual name is one itself."""
  return name if re.fullmatch(r"[\w/ -]*", name) else re.escape(name)
