# /// script
# requires-python = ">=3.11"
# dependencies = ["mjlab-dr", "mujoco"]
#
# [tool.uv.sources]
# mjlab-dr = { path = ".." }
# ///
"""Randomisation of a robot in MuJoCo's own C engine: `uv run packages/dr/examples/randomize_my_robot.py`.

Installs mjlab-dr and what it requires, which is neither Warp nor the rest of mjlab; prints what changed, and how far
the same push then carries each of a few robots.
"""

import importlib.util

import mujoco
from mjlab_dr import body_mass, geom_friction, pseudo_inertia, randomize, randomize_field

ROBOT = """
<mujoco model="pusher">
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body name="base" pos="0 0 0.1">
      <freejoint/>
      <geom name="base" type="box" size="0.2 0.1 0.05" mass="4"/>
      <geom name="sole" type="box" size="0.2 0.1 0.05" pos="0 0 -0.05" mass="1"/>
      <body name="arm" pos="0.15 0 0.05">
        <joint name="lift" axis="0 1 0" range="-1.5 0.5" damping="0.5" armature="0.01"/>
        <geom name="arm" type="capsule" size="0.02" fromto="0 0 0 0.3 0 0" mass="0.5"/>
      </body>
    </body>
  </worldbody>
  <actuator><position name="lift" joint="lift" kp="20" kv="1"/></actuator>
</mujoco>"""


def pushed(model: mujoco.MjModel) -> float:
  """How far a push of 60 N for 0.3 s carries the robot within a second [m]."""
  data = mujoco.MjData(model)
  while data.time < 1.0:
    data.xfrc_applied[model.body("base").id, 0] = 60.0 if data.time < 0.3 else 0.0
    mujoco.mj_step(model, data)
  return float(data.qpos[0])


def main() -> None:
  model = mujoco.MjModel.from_xml_string(ROBOT)
  randomization = randomize(
    model,
    [
      geom_friction("sole|floor", (0.4, 1.2), shared=True),
      body_mass("base", (0.8, 1.3), operation="scale"),
      pseudo_inertia("arm", scale=0.2, t=(-0.02, 0.02)),
      randomize_field("dof_damping", "lift", (0.5, 2.0), operation="scale", distribution="log_uniform"),
      randomize_field("actuator_kp", "lift", (0.9, 1.1)),
      # -kd of a position actuator.
      randomize_field("actuator_biasprm", "lift", {"2": (0.7, 1.3)}, operation="scale"),
    ],
    seed=0,
  )
  print(randomization.report())
  print()
  for number in range(4):
    print(f"robot {number}: pushed {pushed(model):.3f} m")
    randomization.resample()
  randomization.restore()
  print(f"as compiled: pushed {pushed(model):.3f} m")
  absent = [name for name in ("warp", "mujoco_warp", "mjlab_sim", "mjlab") if importlib.util.find_spec(name) is None]
  print(f"not installed: {', '.join(absent) or 'nothing is missing here'}")


if __name__ == "__main__":
  main()
