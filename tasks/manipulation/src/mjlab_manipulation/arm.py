"""Arms that lift: the numbers that the tasks need, and those of the YAM."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from mjlab_robots import YAM_ACTION_SCALE, yam
from mjlab_scene import EntityCfg

# Range of each joint of the YAM [rad, m]
JOINT_RANGE = {
  "joint1": (-2.61799, 3.05433),
  "joint2": (0.0, 3.66519),
  "joint3": (0.0, 3.66519),
  "joint4": (-1.5708, 1.5708),
  "joint5": (-1.5708, 1.5708),
  "joint6": (-2.0944, 2.0944),
  "left_finger": (-0.00205, 0.037524),
}
ARM = tuple(joint for joint in JOINT_RANGE if joint.startswith("joint"))
# One unit of action is at most half the range.
ACTION_SCALE = {joint: min(YAM_ACTION_SCALE[joint], 0.5 * (hi - lo)) for joint, (lo, hi) in JOINT_RANGE.items()}


@dataclass(kw_only=True)
class LiftingArm:
  """Numbers of an arm with a gripper of two fingers that the lifting tasks need."""

  entity: Callable[[], EntityCfg]
  action_scale: dict[str, float]
  """Shift of the target per unit of action by joint pattern [rad, m]."""
  joint_range: dict[str, tuple[float, float]]
  """Range of the targets by joint pattern [rad, m]."""
  arm_joints: tuple[str, ...]
  """Joints without the gripper's, whose speed is limited."""
  hand_site: str
  """Site between the finger tips."""
  wrist: str
  """Body whose subtree, the gripper, must not press on the ground."""
  fingers: tuple[str, str]
  """Bodies of the fingers."""
  finger_tips: str | None = None
  """Pattern of geoms whose friction is randomised."""


def yam_arm() -> LiftingArm:
  """Return the I2RT YAM, of which only the gripper collides."""
  return LiftingArm(
    entity=partial(yam, collision="gripper_only"),
    action_scale=ACTION_SCALE,
    joint_range=JOINT_RANGE,
    arm_joints=ARM,
    hand_site="grasp_site",
    wrist="link_6",
    fingers=("link_left_finger", "link_right_finger"),
    finger_tips="[lr]f_down([6-9]|10|11)_collision",
  )
