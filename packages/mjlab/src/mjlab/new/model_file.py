"""Robot from a model file: read, reduced to the robot, every element named."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import mujoco
from mjlab_core import MjlabError, printable
from mjlab_core.files import reading
from mjlab_scene import EntityCfg

Base = Literal["file", "floating", "fixed"]

_KINDS = {mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE}


@dataclass(kw_only=True)
class RobotModel:
  """Robot as a spec that still has the actuators and keyframes of its file."""

  spec: mujoco.MjSpec
  source: str
  """Name of the file, safe to print."""
  is_floating: bool
  notes: list[str] = field(default_factory=list)
  """Lines for the report: what was changed or guessed."""

  @property
  def joints(self) -> list[mujoco.MjsJoint]:
    """Hinges and slides, in the model's order."""
    return [joint for joint in self.spec.joints if joint.type in _KINDS]

  def compiled(self) -> mujoco.MjModel:
    """Compile a copy."""
    return self.spec.copy().compile()


def read_robot_model(path: Path, base: Base) -> RobotModel:
  """Read an MJCF or URDF file.

  Args:
    path: The file.
    base: "file" takes what an MJCF says; the base of a URDF floats if two or more chains of joints end in its links.

  Raises:
    FileError: There is no such file, or MuJoCo cannot read or compile it.
    MjlabError: It does not hold exactly one robot with joints.
  """
  with reading("robot", path):
    spec = mujoco.MjSpec.from_file(str(path))
    spec.memory = -1
    spec.copy().compile()
  model = RobotModel(spec=spec, source=printable(path.name), is_floating=False)
  _keep_only_the_robot(model)
  _set_base(model, base, is_urdf=path.suffix.lower() == ".urdf")
  # Entities name what has no name; their spec is the one to write.
  try:
    model.spec = EntityCfg(spec_fn=lambda: spec).build("robot").spec
    model.compiled()
  except ValueError as error:
    raise MjlabError(f"{path}: {_one_line(error).removeprefix('entity ')}") from error
  return model


def _one_line(error: BaseException) -> str:
  return printable(" ".join(str(error).split()))


def _keep_only_the_robot(model: RobotModel) -> None:
  spec = model.spec
  roots = [body for body in spec.bodies[1:] if body.parent.name == "world"]
  if len(roots) != 1:
    names = ", ".join(f"'{printable(body.name)}'" for body in roots[:8]) or "none"
    raise MjlabError(f"{model.source}: expected one body at the top level, the robot; there are: {names}")
  ground = [*spec.worldbody.geoms, *spec.worldbody.lights, *spec.worldbody.cameras, *spec.lights]
  geoms = len(spec.worldbody.geoms)
  for element in {id(element): element for element in ground}.values():
    spec.delete(element)
  if geoms:
    model.notes.append(f"left out {geoms} geoms of the world, such as a floor")
  spec.memory = -1


def _set_base(model: RobotModel, base: Base, *, is_urdf: bool) -> None:
  root = next(body for body in model.spec.bodies[1:] if body.parent.name == "world")
  free = [joint for joint in root.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
  floats = bool(free)
  if base != "file":
    floats = base == "floating"
  elif is_urdf and not floats:
    floats = len(last_links(model.spec)) > 1
    model.notes.append(f"a URDF does not say it: the base is {'floating' if floats else 'fixed'} (--base changes it)")
  if floats and not free:
    if root.joints:
      raise MjlabError(f"{model.source}: body '{printable(root.name)}' has joints, so that its base cannot float")
    root.add_freejoint()
  for joint in free if not floats else []:
    model.spec.delete(joint)
  if floats != bool(free):
    # Keyframes have other lengths then.
    for key in list(model.spec.keys):
      model.spec.delete(key)
  model.is_floating = floats


def last_links(spec: mujoco.MjSpec) -> list[mujoco.MjsBody]:
  """Return the bodies with joints below which there are no joints, in the model's order."""

  def below(body: mujoco.MjsBody) -> list[mujoco.MjsBody]:
    found = [last for child in body.bodies for last in below(child)]
    return found or ([body] if any(joint.type in _KINDS for joint in body.joints) else [])

  return below(spec.worldbody)


def subtree(body: mujoco.MjsBody) -> list[mujoco.MjsBody]:
  """Return a body and all bodies below it."""
  return [body, *(below for child in body.bodies for below in subtree(child))]


def without_actuators(spec: mujoco.MjSpec, names: set[str]) -> mujoco.MjSpec:
  """Return a copy without the named actuators and without keyframes."""
  made = spec.copy()
  for key in list(made.keys):
    made.delete(key)
  for actuator in list(made.actuators):
    if actuator.name in names:
      made.delete(actuator)
  return made
