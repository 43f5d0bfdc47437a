"""Maker of the clips that ship with mjlab-motions: `uv run python tools/make_clips.py [FOLDER]`.

Each clip is a score: keyframes of feet, centre of mass, pelvis height and arms, between which everything moves with no
jerk at its ends. Inverse kinematics turns every frame into joint angles. The centre of mass is moved slowly and never
leaves the feet that stand, so the clips could be performed by a robot that only tracks joint angles.
"""

import argparse
import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np
import torch
from mjlab_motions import Kinematics, Motion, check_quality, save_motion, to_ground
from mjlab_robots import SOFT_JOINT_POS_LIMIT_FACTOR, g1_spec

RATE = 50.0  # Hz
FEET = ("left_ankle_roll_link", "right_ankle_roll_link")
SOLE = 0.035  # m, height of an ankle above the ground it stands on
CENTER = 0.038  # m, middle of the sole in front of the ankle
STANCE, NARROW = 0.1185, 0.085  # m, half the distance of the feet; ankles roll too little to step far from a wide one
STANDING, LOW = 0.735, 0.69  # m, height of the pelvis; legs reach sideways only where it is low
LEAN = 0.02  # share of the way between the feet by which the centre of mass stays inside of the one it is over
# Weights of the inverse kinematics: feet, centre of mass, pelvis, joints of arms and waist, of legs.
FOOT, MASS, HEIGHT, UPRIGHT, ARMS, LEGS = 1e3, 1e2, 1e2, 1.0, 1e2, 1e-2
DAMPING = 1e-6


@dataclass
class Score:
  """Keyframes of one clip by channel: (time [s], value); a channel keeps its value before the first and after the last.

  Channels are `left`, `right` (x, y, lift of a foot from its place [m]), `mass` (share of the way from the right to the
  left foot at which the centre of mass is), `height` of the pelvis [m], and joints by name [rad].
  """

  duration: float
  stance: float = STANCE
  keys: dict[str, list[tuple[float, tuple[float, ...]]]] = field(default_factory=dict)

  def at(self, channel: str, time: float, *value: float) -> None:
    """Set a keyframe; times of a channel rise."""
    self.keys.setdefault(channel, []).append((time, value))

  def value(self, channel: str, time: float, default: tuple[float, ...]) -> np.ndarray:
    keys = self.keys.get(channel, [(0.0, default)])
    if time <= keys[0][0]:
      return np.array(keys[0][1])
    for (t0, v0), (t1, v1) in itertools.pairwise(keys):
      if time < t1:
        s = (time - t0) / (t1 - t0)
        return np.array(v0) + (np.array(v1) - np.array(v0)) * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    return np.array(keys[-1][1])


def squat_and_wave() -> Score:
  """Down and up again with arms forward, then a wave with the right hand."""
  score = Score(duration=7.5)
  for time, height in ((0.3, STANDING), (1.7, 0.55), (2.0, 0.55), (3.3, STANDING)):
    score.at("height", time, height)
  for side in ("left", "right"):
    for time, pitch in ((0.3, 0.2), (1.7, -1.2), (2.0, -1.2), (3.3, 0.2)):
      score.at(f"{side}_shoulder_pitch_joint", time, pitch)
    for time, bend in ((0.3, 0.6), (1.7, 1.1), (2.0, 1.1), (3.3, 0.6)):
      score.at(f"{side}_elbow_joint", time, bend)
  for joint, up in (("shoulder_pitch", -0.9), ("shoulder_roll", -1.1), ("elbow", -0.3)):
    down = {"shoulder_pitch": 0.2, "shoulder_roll": -0.2, "elbow": 0.6}[joint]
    for time, value in ((3.5, down), (4.6, up), (6.3, up), (7.3, down)):
      score.at(f"right_{joint}_joint", time, value)
  score.at("right_shoulder_yaw_joint", 3.8, 0.0)
  for beat in range(5):
    score.at("right_shoulder_yaw_joint", 4.6 + 0.4 * beat, (-0.75, -0.05)[beat % 2])
  score.at("right_shoulder_yaw_joint", 7.2, 0.0)
  return score


def march_in_place() -> Score:
  """Four steps on the spot, each after the weight has moved onto the other foot; arms swing against the legs."""
  score = Score(duration=13.4)
  time = 0.4
  score.at("mass", time, 0.5)
  score.at("height", time, STANDING)
  for step in range(4):
    side, other, over = (("left", "right", LEAN), ("right", "left", 1.0 - LEAN))[step % 2]
    time += 1.4 if step == 0 else 1.9
    score.at("mass", time, over)
    swing(score, side, other, time, 0.0)
    for moment, lift in ((0.0, 0.0), (0.5, 0.10), (1.0, 0.0)):
      score.at(side, time + moment, 0.0, 0.0, lift)
    swing(score, side, other, time + 0.5, 0.5)
    time += 1.0
    score.at("mass", time, over)
    swing(score, side, other, time, 0.0)
  score.at("mass", time + 1.4, 0.5)
  return score


def swing(score: Score, side: str, other: str, time: float, angle: float) -> None:
  """Arms at a moment: the one opposite of the lifted leg forward."""
  score.at(f"{other}_shoulder_pitch_joint", time, 0.2 - angle)
  score.at(f"{side}_shoulder_pitch_joint", time, 0.2 + angle)


def side_step_dance() -> Score:
  """Two steps to the left and two back, swaying arms and a turning waist."""
  score = Score(duration=24.0, stance=NARROW)
  place = {"left": 0.0, "right": 0.0}
  time = 0.4
  score.at("mass", time, 0.5)
  score.at("height", 0.4, STANDING)
  for beat, (first, second, width) in enumerate(
    (("left", "right", 0.08), ("left", "right", 0.08), ("right", "left", -0.08), ("right", "left", -0.08))
  ):
    for side in (first, second):
      time += 1.4 if time < 1.0 else 1.9
      weight = LEAN if side == "left" else 1.0 - LEAN
      raised = 1.0 if side == first else 0.0
      score.at("mass", time, weight)
      score.at("height", time, LOW)
      score.at(side, time, 0.0, place[side], 0.0)
      score.at(side, time + 0.4, 0.0, place[side] + 0.5 * width, 0.05)
      place[side] += width
      score.at(side, time + 0.8, 0.0, place[side], 0.0)
      score.at("mass", time + 0.8, weight)
      for arm, sign in (("left", 1.0), ("right", -1.0)):
        score.at(f"{arm}_shoulder_roll_joint", time + 0.4, sign * (0.2 + 0.7 * raised))
        score.at(f"{arm}_elbow_joint", time + 0.4, 0.6 + 0.6 * raised)
      score.at("waist_yaw_joint", time + 0.4, (0.35 if beat % 2 else -0.35) * raised)
      time += 0.8
  score.at("mass", time + 1.4, 0.5)
  score.at("height", time + 1.4, STANDING)
  return score


SCORES: dict[str, Callable[[], Score]] = {
  "squat_and_wave": squat_and_wave,
  "march_in_place": march_in_place,
  "side_step_dance": side_step_dance,
}


class InverseKinematics:
  """Damped least squares over all joints and the root, from the last solution on."""

  def __init__(self, model: mujoco.MjModel, kinematics: Kinematics) -> None:
    self.model, self.data = model, mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, self.data, 0)
    self.posture = self.data.qpos.copy()
    self.columns = {name: 7 + i for i, name in enumerate(kinematics.joint_names)}
    legs = [any(part in name for part in ("hip", "knee", "ankle")) for name in kinematics.joint_names]
    self.pull = np.sqrt(np.where(legs, LEGS, ARMS))
    low, high = model.jnt_range[kinematics.joint_ids].T
    middle, reach = 0.5 * (low + high), 0.499 * SOFT_JOINT_POS_LIMIT_FACTOR * (high - low)
    self.low, self.high = middle - reach, middle + reach

  def solve(self, score: Score, time: float) -> np.ndarray:
    """Root and joints at a moment, (36,)."""
    model, data = self.model, self.data
    feet = {side: score.value(side, time, (0.0, 0.0, 0.0)) for side in ("left", "right")}
    ankles = [
      np.array([0.0, sign * score.stance, SOLE]) + feet[side] for side, sign in (("left", 1.0), ("right", -1.0))
    ]
    share = score.value("mass", time, (0.5,))[0]
    mass = share * ankles[0] + (1.0 - share) * ankles[1] + [CENTER, 0.0, 0.0]
    height = score.value("height", time, (STANDING,))[0]
    posture = self.posture.copy()
    for joint, column in self.columns.items():
      posture[column] = score.value(joint, time, (posture[column],))[0]
    for _ in range(12):
      mujoco.mj_kinematics(model, data)
      mujoco.mj_comPos(model, data)
      rows: list[np.ndarray] = []
      errors: list[np.ndarray] = []
      jac, turn = np.zeros((3, model.nv)), np.zeros((3, model.nv))

      def add(
        weight: float,
        jacobian: np.ndarray,
        error: np.ndarray,
        rows: list[np.ndarray] = rows,
        errors: list[np.ndarray] = errors,
      ) -> None:
        rows.append(np.sqrt(weight) * jacobian)
        errors.append(np.sqrt(weight) * error)

      for foot, ankle in zip(FEET, ankles, strict=True):
        body = model.body(foot).id
        mujoco.mj_jacBody(model, data, jac, turn, body)
        add(FOOT, jac, ankle - data.xpos[body])
        add(FOOT, turn, -rotation_vector(data.xquat[body]))
      mujoco.mj_jacSubtreeCom(model, data, jac, 1)
      add(MASS, jac[:2], (mass - data.subtree_com[1])[:2])
      mujoco.mj_jacBody(model, data, jac, turn, 1)
      add(HEIGHT, jac[2:], np.array([height]) - data.xpos[1, 2:])
      add(UPRIGHT, turn, -rotation_vector(data.xquat[1]))
      add(1.0, self.pull[:, None] * np.eye(model.nv)[6:], self.pull * (posture - data.qpos)[7:])
      jacobian = np.concatenate(rows)
      step = np.linalg.solve(jacobian.T @ jacobian + DAMPING * np.eye(model.nv), jacobian.T @ np.concatenate(errors))
      mujoco.mj_integratePos(model, data.qpos, step, 1.0)
      data.qpos[7:] = np.clip(data.qpos[7:], self.low, self.high)
    return data.qpos.copy()


def rotation_vector(quat: np.ndarray) -> np.ndarray:
  """Rotation away from upright and straight ahead, world axes [rad]."""
  result = np.zeros(3)
  mujoco.mju_quat2Vel(result, quat, 1.0)
  return result


def make(name: str) -> Motion:
  """One of `SCORES` as a motion of the G1."""
  model = g1_spec(meshes="never").compile()
  kinematics = Kinematics(model)
  inverse, score = InverseKinematics(model, kinematics), SCORES[name]()
  for _ in range(20):
    inverse.solve(score, 0.0)
  frames = np.array([inverse.solve(score, i / RATE) for i in range(round(score.duration * RATE) + 1)])
  table = torch.from_numpy(frames)
  motion = Motion(
    name=name,
    rate=RATE,
    root_body="pelvis",
    joint_names=kinematics.joint_names,
    root_pos=table[:, :3],
    root_quat=table[:, 3:7],
    joint_pos=table[:, 7:],
    source="mjlab, tools/make_clips.py: keyframes and inverse kinematics",
    license="Apache-2.0",
    history=("keyframes and inverse kinematics",),
  )
  return to_ground(motion, kinematics)


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__)
  here = Path(__file__).parents[1] / "packages" / "motions" / "src" / "mjlab_motions" / "clips"
  parser.add_argument("folder", nargs="?", type=Path, default=here)
  folder = parser.parse_args().folder
  kinematics = Kinematics(g1_spec(meshes="never").compile())
  for name in SCORES:
    motion = make(name)
    print(check_quality(motion, kinematics).table(), "\n")
    save_motion(motion, folder / f"{name}.npz")


if __name__ == "__main__":
  main()
