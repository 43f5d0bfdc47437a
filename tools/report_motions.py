"""Converts clips that other people made and says how good they are: `uv run python tools/report_motions.py FOLDER`.

FOLDER holds `g1-moves/*.csv` at 60 Hz and `kimodo/*.csv` at 30 Hz; nothing of it is copied. Writes
`docs/motions.md` and a picture of each quality report.
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
from PIL import Image

ROOT = Path(__file__).parents[1]
SOURCES = {
  "g1-moves": (60.0, "experientialtech/g1-moves, CC-BY-4.0: recorded from performers, retargeted"),
  "kimodo": (30.0, "NVlabs/ProtoMotions, Apache-2.0: made by a text-to-motion model"),
}
HEAD = """\
# Clips of other people, converted

Made by `tools/report_motions.py` from clips that are not part of this repository. Each was read with nothing stated but
its rate, resampled to 50 Hz and put on the ground, as `convert-motion --output-rate 50 --ground` does. Orders of
quaternions were proven. "Off" is how far the furthest body in any frame is from where MuJoCo C has it. What the checks
are, [the README](../tasks/tracking/README.md) says.

| clip | from | frames | quaternions | off | report | worst |
|---|---|---|---|---|---|---|
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
  for source, (rate, _) in SOURCES.items():
    for path in sorted((folder / source).glob("*.csv")):
      read = read_motion(path, robot, Statement(rate=rate))
      motion = to_ground(resample(read, 50.0), robot)
      report = check_quality(motion, robot)
      picture = ROOT / "docs" / "pictures" / f"quality_{path.stem}.png"
      plot_quality(report, picture)
      Image.open(picture).convert("RGB").quantize(32).save(picture, optimize=True)
      faults = [f"{f.check} {f.worst:.3g}" for f in report.findings if f.severity != "ok"]
      order, off = read.history[-1].split()[1], deviation(motion, robot)
      frames = f"{read.num_frames} at {rate:g} Hz, {motion.num_frames} at 50 Hz"
      cells = (path.stem, source, frames, order, f"{off:.1e} m", report.severity, ", ".join(faults))
      lines.append(f"| {' | '.join(cells)} |\n")
      pictures.append(f"\n![Checks of {path.stem} over time](pictures/{picture.name})\n")
  sources = "\n".join(f"- {source}: {about}" for source, (_, about) in SOURCES.items())
  text = "".join(lines) + f"\n{sources}\n" + "".join(pictures)
  (ROOT / "docs" / "motions.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
  main()
