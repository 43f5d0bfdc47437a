"""Time of a camera's image in every world, beside that of the physics step it is taken after.

  python tools/benchmark_cameras.py --num-envs 512 4096 --device cuda --output docs/benchmarks

A Go1 with a camera on its head, on a plane or among blocks (`--ground blocks`). Each row is a step graph: physics
alone, then physics and one reading. What a reading adds is the time of its image. "rays" is a ray-cast sensor through
the same pixels, which measures the same distances.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import torch
from benchmark_step import heading, timed
from mjlab_robots import go1
from mjlab_scene import Scene, SceneCfg
from mjlab_sensors import CameraSensorCfg, FrameMatch, PinholeCameraPatternCfg, RayCastSensorCfg, SensorCfg
from mjlab_sim import Simulation, SimulationCfg
from mjlab_terrain import PlaneCfg, RandomGridCfg, TerrainGridCfg

# What is read after the step, by the name of its row.
IMAGES: dict[str, dict[str, Any]] = {
  "depth": {"data_types": ("depth",)},
  "rgb": {"data_types": ("rgb",)},
  "rgb, shadows": {"data_types": ("rgb",), "use_shadows": True},
  "rgb, depth, segmentation": {"data_types": ("rgb", "depth", "segmentation")},
}


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--num-envs", type=int, nargs="+", default=[16])
  parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
  parser.add_argument("--ground", choices=("plane", "blocks"), nargs="+", default=["plane"])
  parser.add_argument("--size", type=int, default=64, help="edge of the image [pixels]")
  parser.add_argument("--steps", type=int, default=50)
  parser.add_argument("--repeats", type=int, default=3)
  parser.add_argument("--output", type=Path, help="folder to write the table to")
  args = parser.parse_args()
  rows = []
  for ground in args.ground:
    for num_envs in args.num_envs:
      for row in measure(num_envs, args.device, ground, args.size, args.steps, args.repeats):
        print(json.dumps(row), flush=True)
        rows.append(row)
  if args.output:
    write(args.output, args.device, rows)


def measure(num_envs: int, device: str, ground: str, size: int, steps: int, repeats: int) -> list[dict[str, Any]]:
  """A row for physics alone and one for each sensor: milliseconds of a step with its reading, and what that adds."""
  sensors: dict[str, SensorCfg] = {
    name: CameraSensorCfg(
      body="robot/trunk", pos=(0.3, 0.0, 0.08), quat=(0.58, 0.41, -0.41, -0.58), width=size, height=size, **fields
    )
    for name, fields in IMAGES.items()
  }
  sensors["rays"] = RayCastSensorCfg(
    frames=FrameMatch(type="camera", pattern="depth"),
    pattern=PinholeCameraPatternCfg.from_mujoco_camera("depth"),
    max_distance=100.0,
  )
  blocks = TerrainGridCfg(rows=5, columns=5, border_width=5.0, types={"blocks": RandomGridCfg()})
  terrain = PlaneCfg() if ground == "plane" else blocks
  entities = {"robot": go1()}
  scene = Scene(SceneCfg(num_envs=num_envs, terrain=terrain, entities=entities, sensors=sensors))
  sim = Simulation(num_envs, scene.spec, SimulationCfg(timestep=0.005, nconmax=60, njmax=200), device)
  scene.initialize(sim)
  rows: list[dict[str, Any]] = []
  for name in ("nothing", *sensors):

    def step(name: str = name) -> None:
      scene.write_ctrl()
      sim.step()
      if name in sensors:
        _ = scene[name].data

    total = 1e3 * timed(sim.capture(step), steps, repeats, sim.device)
    image = total - rows[0]["step_ms"] if rows else 0.0
    row = {"worlds": num_envs, "ground": ground, "geoms": sim.mj_model.ngeom, "image": name}
    rows.append({**row, "step_ms": round(total, 3), "image_ms": round(image, 3)})
  sim.close()
  return rows


def write(folder: Path, device: str, rows: list[dict[str, Any]]) -> None:
  """The rows as a Markdown table."""
  folder.mkdir(parents=True, exist_ok=True)
  lines = ["| " + " | ".join(rows[0]) + " |", "|" + " --- |" * len(rows[0])]
  lines += ["| " + " | ".join(str(value) for value in row.values()) + " |" for row in rows]
  path = folder / f"cameras_{device.split(':')[0]}.md"
  path.write_text(heading("Images beside a physics step", device) + "\n\n" + "\n".join(lines) + "\n")
  print(f"wrote {path}")


if __name__ == "__main__":
  main()
