"""Time of a reading in every world, beside that of the physics step it is taken after.

  python tools/benchmark_sensors.py --num-envs 512 4096 --device cuda --output docs/benchmarks

A Go1 on a plane or among blocks (`--ground blocks`), with a height scan of 187 rays, a lidar of 16 rows and 64 columns
on its back, contacts of its feet, an IMU, and a camera on its head. Each row is a step graph: physics alone, then
physics and one reading. What a reading adds is its time. "camera rays" is a ray-cast sensor through the pixels of the
camera, which measures the same distances as its depth.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import torch
from benchmark_step import heading, timed
from mjlab_robots import go1
from mjlab_scene import Scene, SceneCfg
from mjlab_sensors import (
  CameraSensorCfg,
  ContactMatch,
  ContactSensorCfg,
  FrameMatch,
  GridPatternCfg,
  ImuSensorCfg,
  LidarPatternCfg,
  ObjRef,
  PinholeCameraPatternCfg,
  RayCastSensorCfg,
  SensorCfg,
)
from mjlab_sim import Simulation, SimulationCfg
from mjlab_terrain import PlaneCfg, RandomGridCfg, TerrainGridCfg

TRUNK = FrameMatch(type="body", pattern="trunk", entity="robot")
# Where the camera sits, and looks ahead and a little down.
EYE: dict[str, Any] = {"body": "robot/trunk", "pos": (0.3, 0.0, 0.08), "quat": (0.58, 0.41, -0.41, -0.58)}
IMAGES: dict[str, dict[str, Any]] = {
  "depth": {"data_types": ("depth",)},
  "rgb": {"data_types": ("rgb",)},
  "rgb, shadows": {"data_types": ("rgb",), "use_shadows": True},
  "rgb, depth, segmentation": {"data_types": ("rgb", "depth", "segmentation")},
}
OTHERS: dict[str, SensorCfg] = {
  "height scan": RayCastSensorCfg(
    frames=TRUNK,
    pattern=GridPatternCfg(size=(1.6, 1.0), resolution=0.1),
    alignment="yaw",
    start_height=1.0,
    geom_groups=(0,),
  ),
  "lidar": RayCastSensorCfg(
    frames=TRUNK, pattern=LidarPatternCfg(rows=16, columns=64), exclude_own_tree=True, max_distance=30.0
  ),
  "contacts": ContactSensorCfg(
    primary=ContactMatch(mode="geom", pattern=".*_foot_collision", entity="robot"),
    secondary=ContactMatch(mode="body", pattern="terrain"),
    track_air_time=True,
    history_length=4,
  ),
  "imu": ImuSensorCfg(site=ObjRef(type="site", name="imu", entity="robot"), gyro_bias=0.1, gyro_walk=0.01),
}
NAMES = (*OTHERS, *IMAGES, "camera rays")


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--num-envs", type=int, nargs="+", default=[16])
  parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
  parser.add_argument("--ground", choices=("plane", "blocks"), nargs="+", default=["plane"])
  parser.add_argument("--sensors", choices=NAMES, nargs="+", default=NAMES, metavar="NAME", help=", ".join(NAMES))
  parser.add_argument("--size", type=int, default=64, help="edge of the image [pixels]")
  parser.add_argument("--steps", type=int, default=50)
  parser.add_argument("--repeats", type=int, default=3)
  parser.add_argument("--output", type=Path, help="folder to write the table to")
  args = parser.parse_args()
  rows = []
  for ground in args.ground:
    for num_envs in args.num_envs:
      for row in measure(num_envs, args.device, ground, args.sensors, args.size, args.steps, args.repeats):
        print(json.dumps(row), flush=True)
        rows.append(row)
  if args.output:
    write(args.output, args.device, rows)


def configure(names: list[str], size: int) -> dict[str, SensorCfg]:
  """Return the sensors of these names; rays through pixels also need their camera."""
  sensors: dict[str, SensorCfg] = {name: OTHERS[name] for name in names if name in OTHERS}
  for name in IMAGES:
    if name in names or (name == "depth" and "camera rays" in names):
      sensors[name] = CameraSensorCfg(**EYE, width=size, height=size, **IMAGES[name])
  if "camera rays" in names:
    sensors["camera rays"] = RayCastSensorCfg(
      frames=FrameMatch(type="camera", pattern="depth"),
      pattern=PinholeCameraPatternCfg.from_mujoco_camera("depth"),
      max_distance=100.0,
    )
  return sensors


def measure(
  num_envs: int, device: str, ground: str, names: list[str], size: int, steps: int, repeats: int
) -> list[dict[str, Any]]:
  """Return a row for physics alone and one per sensor: milliseconds of a step with its reading, and the difference."""
  sensors = configure(names, size)
  blocks = TerrainGridCfg(rows=5, columns=5, border_width=5.0, types={"blocks": RandomGridCfg()})
  terrain = PlaneCfg() if ground == "plane" else blocks
  entities = {"robot": go1()}
  scene = Scene(SceneCfg(num_envs=num_envs, terrain=terrain, entities=entities, sensors=sensors))
  sim = Simulation(num_envs, scene.spec, SimulationCfg(timestep=0.005, nconmax=60, njmax=200), device)
  scene.initialize(sim)
  rows: list[dict[str, Any]] = []
  for name in ("nothing", *(name for name in sensors if name in names)):

    def step(name: str = name) -> None:
      scene.write_ctrl()
      sim.step()
      if name in sensors:
        scene[name].update(sim.timestep)
        _ = scene[name].data

    total = 1e3 * timed(sim.capture(step), steps, repeats, sim.device)
    reading = total - rows[0]["step_ms"] if rows else 0.0
    row = {"worlds": num_envs, "ground": ground, "geoms": sim.mj_model.ngeom, "sensor": name}
    rows.append({**row, "step_ms": round(total, 3), "reading_ms": round(reading, 3)})
  sim.close()
  return rows


def write(folder: Path, device: str, rows: list[dict[str, Any]]) -> None:
  """Return the rows as a Markdown table."""
  folder.mkdir(parents=True, exist_ok=True)
  lines = ["| " + " | ".join(rows[0]) + " |", "|" + " --- |" * len(rows[0])]
  lines += ["| " + " | ".join(str(value) for value in row.values()) + " |" for row in rows]
  path = folder / f"sensors_{device.split(':')[0]}.md"
  path.write_text(heading("Readings beside a physics step", device) + "\n\n" + "\n".join(lines) + "\n")
  print(f"wrote {path}")


if __name__ == "__main__":
  main()
