"""Conversion and quality reports of public clips: `uv run python tools/report_motions.py FOLDER`.

FOLDER holds `g1-moves/*.csv` at 60 Hz, `kimodo/*.csv` at 30 Hz and `shuffle_dance.npz`, which says its times; nothing
of it is copied. Writes `docs/motions.md` and a picture of each quality report.
"""

import argparse
from pathlib import Path

import mujoco
import numpy as np
import torch
from mjlab_motions import (
  Kinematics,
  Motion,
  Statement,
  check_quality,
  derived_arrays,
  plot_quality,
  read_motion,
  resample,
  to_ground,
)
from mjlab_motions.quality import LIMITS
from mjlab_robots import g1_spec
from PIL import Image

ROOT = Path(__file__).parents[1]
SOURCES = {
  "g1-moves": ("g1-moves/*.csv", 60.0, "experientialtech/g1-moves, CC-BY-4.0: recorded from performers, retargeted"),
  "kimodo": ("kimodo/*.csv", 30.0, "NVlabs/ProtoMotions, Apache-2.0: made by a text-to-motion model"),
  "mujoco_warp": ("shuffle_dance.npz", None, "google-deepmind/mujoco_warp, Apache-2.0: a rollout of a simulation"),
}
HEAD = """\
# Public clips, converted

Quality reports of `convert-motion` for nine clips of the Unitree G1 that are not part of this repository. For a clip
of your own, with a film of it:

```bash
uv run convert-motion my_clip.csv --rate 60 --output-rate 50 --ground --report my_clip.png --video my_clip.mp4
```

Each clip below was read with its rate stated (the rollout contains its times), resampled to 50 Hz and put on the
ground, as above. "Order" is the order of the quaternions in the file: proven, or that of MuJoCo for the rollout.
"Off" is the largest distance of a body from MuJoCo C's kinematics. "Worst" names the checks that warn, with their
largest value.

| clip | from | frames | order | off | report | worst |
|---|---|---|---|---|---|---|
"""
READING = """
## How to read a report

Each picture has one row for each check, over the time of the clip: green for no finding, orange for a warning, red
for an error. The dotted line is the limit of the warning, the dashed one is the value with a score of 1. [The
README](../packages/motions/README.md) has them as a table. A clip with a warning is written. A clip with an error is
not written without `--accept-errors`, because a simulation cannot start in such a frame.

- `joint_limit`: the clip has a pose that the robot cannot take. No option changes that.
- `joint_speed`, `root_speed`, `root_turning`: single spikes are faults of a recording, which `--smooth 0.02` flattens
  or `--crop` removes; broad hills are fast motions.
- `penetration`, `floating`: if constant, the clip is too low or too high, which `--ground` changes; if occasional,
  the feet do not meet the ground, which no option changes.
- `foot_skate`: feet slide while they carry the robot. No option changes that. Policies can track such clips: B_Fence1
  of G1 Moves has a foot skate of 0.575 m/s, and a published policy tracks it for 32 s in 64 of 64 episodes.

## Comparison with published npz files

G1 Moves publishes each clip as CSV and as the `.npz` of the converter of mjlab. `B_HandsUp`, converted here at 60 Hz:

| quantity | frames | largest difference |
|---|---|---|
| joint positions | all | 8e-6 rad |
| body positions | all | 1.7e-6 m |
| body velocities | all but the first and the last | 5e-5 m/s |
| body velocities | first, left ankle | 0.056 m/s |
| body velocities | last | 0.019 m/s |

- The small differences come from single precision: the published converter interpolates at rounded times.
- The published file lacks the last frame.
- At both ends the published converter repeats the angular velocity of the neighbouring frame, but takes one-sided
  differences for positions and joints. Here all are one-sided. The conversion here is right: the first displacement
  of the left ankle, divided by the time step, agrees with it within 2e-4 m/s, and differs from the published velocity
  by 0.056 m/s.

Two other clips were reported to differ at the left ankle in a few frames: body positions by 0.8 and 1.7 mm,
velocities by 0.02 and 0.05 m/s. Their files were not available here, so the cause is inferred:

- Reproduced, and held by a test: one reading of `left_ankle_pitch_joint` that differs by 0.0455 or 0.097 rad in a
  single frame moves only `left_ankle_roll_link`, by 0.80 or 1.70 mm, and changes its velocity in the frames around it
  by 0.024 or 0.051 m/s.
- A different quaternion interpolation, root order or time of sampling moves all bodies. The converter of the
  reference, repeated in single precision on five clips at 60 and 50 Hz, differs by at most 5e-6 m.
- Joint limits do not explain it: the described method does not clamp angles, and none of the five CSV files exceeds a
  limit.
- CSV files of the dataset were revised: the public history of `M_ShortMove14.csv` has two versions with different arm
  angles. So the CSV and the npz of a clip may come from different revisions.

Hence in those clips the CSV and the npz most likely hold different joint angles, and each conversion is right for its
own file. To compare with a published policy, read the npz that it was trained on; `read_motion` proves that its
joints and bodies agree.
"""


def deviation(motion: Motion, robot: Kinematics) -> float:
  """Largest distance of a body from MuJoCo C's kinematics [m]."""
  derived, data, worst = derived_arrays(motion, robot), mujoco.MjData(robot.model), 0.0
  for frame in range(motion.num_frames):
    data.qpos[:] = torch.cat((motion.root_pos[frame], motion.root_quat[frame], motion.joint_pos[frame]))
    mujoco.mj_kinematics(robot.model, data)
    worst = max(worst, float(np.abs(derived["body_pos_w"][frame] - data.xpos[1:]).max()))
  return worst


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__)
  parser.add_argument("folder", type=Path)
  folder = parser.parse_args().folder
  robot = Kinematics(g1_spec(meshes="never").compile())
  lines, pictures = [HEAD], []
  for source, (pattern, rate, _) in SOURCES.items():
    for path in sorted(folder.glob(pattern)):
      read = read_motion(path, robot, Statement(rate=rate))
      motion = to_ground(resample(read, 50.0), robot)
      report = check_quality(motion, robot)
      picture = ROOT / "docs" / "pictures" / f"quality_{path.stem}.png"
      plot_quality(report, picture)
      Image.open(picture).convert("RGB").quantize(32).save(picture, optimize=True)
      faults = [f"{f.check} {f.worst:.3g} {LIMITS[f.check].unit}" for f in report.findings if f.severity != "ok"]
      order, off = read.history[-1].split()[1], deviation(motion, robot)
      frames = f"{read.num_frames} at {read.rate:g} Hz, {motion.num_frames} at 50 Hz"
      cells = (
        f"[{path.stem}](#{path.stem.lower()})",
        source,
        frames,
        order,
        f"{off:.1e} m",
        report.severity,
        ", ".join(faults),
      )
      lines.append(f"| {' | '.join(cells)} |\n")
      pictures.append(f"\n## {path.stem}\n\n![Checks of {path.stem} over time](pictures/{picture.name})\n")
  sources = "\n".join(f"- {source}: {about}" for source, (*_, about) in SOURCES.items())
  text = "".join(lines) + f"\n{sources}\n" + READING + "".join(pictures)
  (ROOT / "docs" / "motions.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
  main()
