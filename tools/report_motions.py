"""Converts clips that other people made and says how good they are: `uv run python tools/report_motions.py FOLDER`.

FOLDER holds `g1-moves/*.csv` at 60 Hz, `kimodo/*.csv` at 30 Hz and `shuffle_dance.npz`, which says its times; nothing
of it is copied. Writes `docs/motions.md` and a picture of each quality report.
"""

import argparse
from pathlib import Path

import mujoco
import numpy as np
import torch
from mjlab_robots import g1_spec
from mjlab_tracking import (
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
from mjlab_tracking.quality import LIMITS
from PIL import Image

ROOT = Path(__file__).parents[1]
SOURCES = {
  "g1-moves": ("g1-moves/*.csv", 60.0, "experientialtech/g1-moves, CC-BY-4.0: recorded from performers, retargeted"),
  "kimodo": ("kimodo/*.csv", 30.0, "NVlabs/ProtoMotions, Apache-2.0: made by a text-to-motion model"),
  "mujoco_warp": ("shuffle_dance.npz", None, "google-deepmind/mujoco_warp, Apache-2.0: a rollout of a simulation"),
}
HEAD = """\
# Clips of other people, converted

What the quality report of `convert-motion` looks like on nine clips of the Unitree G1 that are not part of this
repository. For a clip of your own, with a film of it:

```bash
uv run convert-motion my_clip.csv --rate 60 --output-rate 50 --ground --report my_clip.png --video my_clip.mp4
```

Each clip below was read with nothing stated but its rate (of the rollout not even that: it says its times), resampled
to 50 Hz and put on the ground, as above. "Order" is that of the quaternions in the file, which was proven, or MuJoCo's
in the rollout. "Off" is how far the furthest body in any frame is from where MuJoCo C has it. "Worst" names the checks
that warn, with their largest value.

| clip | from | frames | order | off | report | worst |
|---|---|---|---|---|---|---|
"""
READING = """
## How to read a report

Each picture has one row for each check, over the time of the clip: green where all is well, orange where the check
warns, red where it fails. The dotted line is the limit of the warning, the dashed one, where it is in sight, that of
the failure; [the README](../tasks/tracking/README.md) has them as a table. A clip with a failure is not written unless
`--accept-errors` says so; one with warnings is.

- `joint_limit`: the clip asks for a pose that the robot cannot take. No option mends that.
- `joint_speed`, `root_speed`, `root_turning`: single spikes are faults of a recording, which `--smooth 0.02` flattens
  or `--crop` cuts off; broad hills are fast motions.
- `penetration`, `floating`: all the time, the clip is too low or too high, which `--ground` mends; now and then, feet
  do not meet the ground as they should, which no option does.
- `foot_skate`: feet slide while they carry the robot. No option mends that.
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
