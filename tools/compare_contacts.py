"""Compare contacts and contact forces of MuJoCo Warp with MuJoCo C, pair of shapes by pair of shapes.

  python tools/compare_contacts.py --output docs/benchmarks

One body falls, tumbles and rests. In each physics step both engines get the state of MuJoCo C. MuJoCo Warp then
computes the forces twice: from the contacts that it finds itself, and from those of MuJoCo C. The first differs where
collision does, the second where the solver or the reading of forces does.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import warp as wp
from benchmark_step import heading
from mjlab_core import host_contacts
from scipy.optimize import linear_sum_assignment

SHAPES = {
  "sphere": 'type="sphere" size=".1"',
  "capsule": 'type="capsule" size=".05 .1"',
  "box": 'type="box" size=".1 .08 .06"',
  "cylinder": 'type="cylinder" size=".08 .1"',
  "ellipsoid": 'type="ellipsoid" size=".1 .07 .05"',
}
GROUNDS = {
  "plane": '<geom type="plane" size="2 2 .1"/>',
  "box": '<geom type="box" size="1 1 .1" pos="0 0 -.1"/>',
  "cylinder": f'<geom type="plane" size="2 2 .1"/><body pos="0 0 .1"><freejoint/><geom {SHAPES["cylinder"]}/></body>',
  "ellipsoid": f'<geom type="plane" size="2 2 .1"/><body pos="0 0 .1"><freejoint/><geom {SHAPES["ellipsoid"]}/></body>',
}


@dataclass
class Differences:
  """Differences of one state."""

  same_number: bool
  position: float
  """Largest distance between a contact of one engine and its counterpart [m]; NaN where their numbers differ."""
  angle: float
  """Largest angle between their normals [deg]."""
  depth: float
  """Largest difference of their distances [m]."""
  force: float
  """Difference of the net force, relative to that of MuJoCo C or 1 N."""
  force_from_same_contacts: float


def model_of(shape: str, ground: str) -> mujoco.MjModel:
  return mujoco.MjModel.from_xml_string(f"""
    <mujoco>
      <option timestep=".005" integrator="implicitfast" iterations="50" ls_iterations="50"/>
      <worldbody>{GROUNDS[ground]}
        <body pos="0 0 .35" quat="1 .3 .2 .1"><freejoint/><geom {SHAPES[shape]}/></body>
      </worldbody>
    </mujoco>""")


def solve(model: mujoco.MjModel, m: Any, data: mujoco.MjData, *, collide: bool) -> tuple[np.ndarray, ...]:
  """Return position, normal, distance and world-frame force of the contacts in MuJoCo Warp, at the state of `data`."""
  d: Any = mjw.put_data(model, data, nconmax=32, njmax=160)
  m.opt.run_collision_detection = collide
  mjw.forward(m, d)
  count = int(d.nacon.numpy()[0])
  wrench: Any = wp.zeros(count, dtype=wp.spatial_vector)
  if count:
    mjw.contact_force(m, d, wp.array(np.arange(count), dtype=int), True, wrench)
  contact = d.contact
  solved = np.flatnonzero(contact.efc_address.numpy()[:count, 0] >= 0)
  force = wrench.numpy().reshape(-1, 6)[solved, :3]
  return contact.pos.numpy()[solved], contact.frame.numpy()[solved, 0], contact.dist.numpy()[solved], force


def compare(shape: str, ground: str, steps: int) -> list[Differences]:
  model = model_of(shape, ground)
  data = mujoco.MjData(model)
  data.qvel[:] = np.random.default_rng(0).normal(0.0, 0.5, model.nv)
  m: Any = mjw.put_model(model)
  m.opt.warn_overflow = 0
  rows = []
  for _ in range(steps):
    mujoco.mj_forward(model, data)
    expected = host_contacts(model, data)
    if len(expected.pos):
      net = expected.force.sum(axis=0)
      scale = max(float(np.linalg.norm(net)), 1.0)
      pos, normal, dist, force = solve(model, m, data, collide=True)
      *_, same = solve(model, m, data, collide=False)
      position = angle = depth = np.nan
      if len(pos) == len(expected.pos):
        apart = np.linalg.norm(pos[:, None] - expected.pos[None], axis=2)
        here, there = linear_sum_assignment(apart)
        cosine = (normal[here] * expected.normal[there]).sum(axis=1)
        position, angle = apart[here, there].max(), np.degrees(np.arccos(cosine.clip(-1.0, 1.0))).max()
        depth = np.abs(dist[here] - expected.dist[there]).max()
      rows.append(
        Differences(
          same_number=len(pos) == len(expected.pos),
          position=position,
          angle=angle,
          depth=depth,
          force=float(np.linalg.norm(force.sum(axis=0) - net)) / scale,
          force_from_same_contacts=float(np.linalg.norm(same.sum(axis=0) - net)) / scale,
        )
      )
    mujoco.mj_step(model, data)
  return rows


def row_of(shape: str, ground: str, rows: list[Differences]) -> str:
  def most(name: str) -> float:
    return np.nanmax([getattr(row, name) for row in rows])

  force = np.array([row.force for row in rows])
  return (
    f"| {shape} on {ground} | {len(rows)} | {100.0 * np.mean([row.same_number for row in rows]):.0f} %"
    f" | {most('position'):.0e} | {most('angle'):.1g} | {most('depth'):.0e}"
    f" | {np.median(force):.0e} | {np.quantile(force, 0.99):.0e} | {force.max():.0e}"
    f" | {most('force_from_same_contacts'):.0e} |"
  )


def main() -> None:
  parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
  parser.add_argument("--steps", type=int, default=300)
  parser.add_argument("--grounds", nargs="+", choices=list(GROUNDS), default=list(GROUNDS))
  parser.add_argument("--output", type=Path, help="folder to write the table to")
  args = parser.parse_args()
  wp.config.log_level = wp.LOG_WARNING
  wp.set_device("cpu")
  lines = [
    heading("Contacts of MuJoCo Warp beside those of MuJoCo C", "cpu"),
    "",
    "States of a body that falls, tumbles and rests. Differences are the largest of all states, forces relative to the",
    "net force of MuJoCo C or 1 N. The last column has MuJoCo C's contacts in MuJoCo Warp's solver.",
    "",
    "| pair | states | same number of contacts | position [m] | normal [deg] | depth [m] | force, median | force, 99 %"
    " | force, largest | force from MuJoCo C's contacts, largest |",
    "|---|---|---|---|---|---|---|---|---|---|",
  ]
  for ground in args.grounds:
    for shape in SHAPES:
      lines.append(row_of(shape, ground, compare(shape, ground, args.steps)))
      print(lines[-1], flush=True)
  if args.output:
    (args.output / "contacts_convex.md").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
  main()
