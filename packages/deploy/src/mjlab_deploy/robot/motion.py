"""The clip that a policy follows, frame by frame."""

import math

import mujoco
import numpy as np

from mjlab_deploy.bundle import Bundle
from mjlab_deploy.errors import DeployError

_SHAPES = {"joint_position": 0, "joint_velocity": 0, "anchor_position": 3, "anchor_orientation": 4}


class MotionPlayer:
  """Readings "motion/..." of the clip of a bundle; step t of an episode shows frame t + 1.

  Args:
    bundle: A bundle with a motion.

  Raises:
    DeployError: The clip does not fit its description.
  """

  def __init__(self, bundle: Bundle) -> None:
    motion = bundle.description.motion
    assert motion is not None
    self._arrays = bundle.arrays("motion.npz")
    for name, width in _SHAPES.items():
      wanted = (motion.num_frames, width or len(motion.joint_names))
      found = self._arrays[name].shape if name in self._arrays else None
      if found != wanted:
        raise DeployError(f"motion.npz: {name} is {found}, bundle.json says {wanted}")
    self.anchor_body, self._last = motion.anchor_body, motion.num_frames - 1
    self._turn, self._shift = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
    self.reset()

  def reset(self) -> None:
    """Start the clip again."""
    self.frame = min(1, self._last)

  def align(self, position: np.ndarray, orientation: np.ndarray) -> None:
    """Turn and shift the clip on the ground so that its first anchor has the heading and place of the robot's."""
    first = self._arrays["anchor_orientation"][0]
    half = 0.5 * (_heading(orientation) - _heading(first))
    self._turn = np.array([math.cos(half), 0.0, 0.0, math.sin(half)])
    start = _rotate(self._turn, self._arrays["anchor_position"][0])
    self._shift = np.array([position[0] - start[0], position[1] - start[1], 0.0])

  def readings(self) -> dict[str, np.ndarray]:
    """Return the readings of the present frame."""
    row = {name: value[self.frame] for name, value in self._arrays.items() if name in _SHAPES}
    row["anchor_position"] = _rotate(self._turn, row["anchor_position"]) + self._shift
    row["anchor_orientation"] = _multiply(self._turn, row["anchor_orientation"])
    return {f"motion/{name}": value for name, value in row.items()}

  def advance(self) -> None:
    """Show the next frame."""
    self.frame = min(self.frame + 1, self._last)


def _heading(quat: np.ndarray) -> float:
  w, x, y, z = quat
  return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def _multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
  out = np.empty(4)
  mujoco.mju_mulQuat(out, a, b)
  return out


def _rotate(quat: np.ndarray, vector: np.ndarray) -> np.ndarray:
  out = np.empty(3)
  mujoco.mju_rotVecQuat(out, vector, quat)
  return out
