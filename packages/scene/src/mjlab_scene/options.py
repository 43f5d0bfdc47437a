"""One set of physics options for a scene whose parts may each bring their own."""

from typing import Any

import mujoco
import numpy as np

_SIZES = ("memory", "nuserdata", "nuser_body", "nuser_jnt", "nuser_geom", "nuser_site", "nuser_cam", "nuser_tendon")
_SIZES += ("nuser_actuator", "nuser_sensor")
_OPTIONS = tuple(
  name
  for name in dir(mujoco.MjSpec().option)
  if not name.startswith("_") and not callable(getattr(mujoco.MjSpec().option, name))
)


class OptionMerger:
  """Carries the options of attached specs over to their scene.

  MuJoCo does not propagate the options of an attached spec, and writes a warning where they differ. Here an option
  that a part sets to other than MuJoCo's default becomes the scene's; two parts that set it differently are an error.
  """

  def __init__(self, scene: mujoco.MjSpec) -> None:
    self._scene = scene
    self._default = mujoco.MjSpec().option
    self._setter: dict[str, str] = {}

  def adopt(self, part: mujoco.MjSpec, name: str) -> None:
    """Merge the options of `part` into the scene's; then both agree in every option.

    Raises:
      ValueError: `part` and another part set the same option to different values; the message names both.
    """
    for option in _OPTIONS:
      mine = getattr(part.option, option)
      if not _equal(mine, getattr(self._default, option)):
        theirs = getattr(self._scene.option, option)
        other = self._setter.get(option)
        if other is not None and not _equal(mine, theirs):
          raise ValueError(
            f"option '{option}': {name} says {_text(mine)} and {other} says {_text(theirs)}; "
            "the worlds of a scene share their options, so set one of them to the other's value or to the default"
          )
        _assign(self._scene.option, option, mine)
        self._setter[option] = name
      _assign(part.option, option, getattr(self._scene.option, option))
    for size in _SIZES:
      largest = max(getattr(self._scene, size), getattr(part, size))
      setattr(self._scene, size, largest)
      setattr(part, size, largest)


def _assign(option: Any, name: str, value: Any) -> None:
  if np.ndim(value):
    getattr(option, name)[:] = value
  else:
    setattr(option, name, value)


def _equal(a: Any, b: Any) -> bool:
  return bool(np.all(np.asarray(a) == np.asarray(b)))


def _text(value: Any) -> str:
  return str(np.asarray(value).tolist())
