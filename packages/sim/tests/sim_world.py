"""One small model that has something of everything, states for it, and MuJoCo C as its oracle.

Kernels of MuJoCo Warp are compiled per model, so that one model, one `njmax` and one number of iterations serve all
tests of this package.
"""

from collections.abc import Callable, Iterable
from typing import Any

import mujoco
import numpy as np
import torch
from mjlab_sim import Simulation

# Moving geoms touch the floor only. Floating bodies rest on it, the arm and the pendulum hang free, the weld holds the
# block near the mocap body. Geoms of the fence collide with nothing: they are there for rays.
WORLD = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast" iterations="50" ls_iterations="30"/>
  <default><geom contype="1" conaffinity="2"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" contype="2" conaffinity="1"/>
    <body name="ball" pos="0 0 .0995"><freejoint/>
      <geom name="ball" size=".1" mass="1"/><site name="ball" pos=".02 0 .05"/></body>
    <body name="rod" pos=".6 0 .0495" quat="1 0 1 0"><freejoint/>
      <geom name="rod" type="capsule" size=".05 .15" mass=".5"/></body>
    <body name="block" pos="1.2 0 .0995" simple="false"><freejoint/>
      <geom name="block" type="box" size=".2 .15 .1" mass="2" condim="4"/><site name="block" pos="0 0 .1"/></body>
    <body name="upper" pos="0 1 1">
      <joint name="shoulder" axis="0 1 0" damping=".1" armature=".01"/>
      <geom name="upper" type="capsule" size=".04" fromto="0 0 0 .4 0 0" mass="1"/>
      <camera name="eye" pos="0 -2 1" xyaxes="1 0 0 0 0.4 1"/>
      <light name="lamp" pos="0 0 3"/>
      <body name="lower" pos=".4 0 0">
        <joint name="elbow" axis="0 1 0" range="-2 .2" limited="true" frictionloss=".05"/>
        <geom name="lower" type="capsule" size=".03" fromto="0 0 0 .3 0 0" mass=".4"/>
        <site name="hand" pos=".3 0 0"/>
      </body>
    </body>
    <body name="pendulum" pos="0 -1 1"><joint name="socket" type="ball" damping=".02"/>
      <geom name="bob" size=".06" pos=".05 0 -.3" mass=".3"/></body>
    <body name="target" pos="1.2 1 .5" mocap="true"><geom name="target" size=".03" contype="0" conaffinity="0"/></body>
    <body name="fence" pos="-2 0 .5">
      <geom name="post" type="cylinder" size=".2 .4" contype="0" conaffinity="0" group="1"/>
      <geom name="egg" type="ellipsoid" size=".3 .2 .4" pos="0 1 0" contype="0" conaffinity="0" group="2"/>
      <geom name="crate" type="box" size=".3 .2 .1" pos="0 -1 0" quat=".9 .1 .3 .2" contype="0" conaffinity="0"
        group="3"/>
    </body>
  </worldbody>
  <equality><connect name="leash" body1="pendulum" body2="target" anchor="0 0 -.3" active="false"/></equality>
  <tendon><fixed name="rope" stiffness="2" springlength="0.1">
    <joint joint="shoulder" coef="1"/><joint joint="elbow" coef="-.5"/></fixed></tendon>
  <actuator>
    <position name="shoulder" joint="shoulder" kp="20" kv="1" forcerange="-30 30"/>
    <motor name="elbow" joint="elbow" gear="2"/>
    <general name="rope" tendon="rope" dyntype="filter" dynprm=".05" gainprm="3"/>
  </actuator>
  <sensor>
    <accelerometer name="accelerometer" site="ball"/>
    <framepos name="position" objtype="site" objname="hand"/>
    <gyro name="gyro" site="hand"/>
    <force name="force" site="hand"/>
    <velocimeter name="velocimeter" site="ball"/>
    <jointpos name="angle" joint="elbow"/>
    <jointvel name="rate" joint="elbow"/>
    <actuatorfrc name="motor" actuator="elbow"/>
    <tendonpos name="rope" tendon="rope"/>
    <touch name="touch" site="block"/>
    <contact name="contact" geom1="block" geom2="floor" num="4" data="found force pos normal"/>
    <subtreecom name="com" body="upper"/>
    <framelinacc name="acceleration" objtype="body" objname="lower"/>
  </sensor>
</mujoco>
"""
NUM_WORLDS = 4
MakeSim = Callable[..., Simulation]
SIZES: dict[str, Any] = {"nconmax": 16, "njmax": 64, "integrator": None}


MOTION = ("qpos", "qvel", "xpos", "sensordata", "qacc")


def assert_same(sim: Simulation, other: Simulation, names: Iterable[str] = MOTION, worlds: Any = slice(None)) -> None:
  """Assert that fields are bit-identical in two simulations."""
  for name in names:
    assert torch.equal(getattr(sim.data, name)[worlds], getattr(other.data, name)[worlds]), name


def scatter(sim: Simulation, seed: int = 0) -> None:
  """Give every world a different state: moving, driven, pushed, and in contact."""
  rng = np.random.default_rng(seed)
  n, model = sim.num_envs, sim.mj_model

  def noise(count: int, scale: float) -> torch.Tensor:
    return torch.tensor(rng.normal(0.0, scale, (n, count)), dtype=sim.dtype, device=sim.device)

  qpos = sim.data.qpos
  qpos[:, :2] += noise(2, 0.1)
  qpos[:, 7:9] += noise(2, 0.1)
  qpos[:, 14:16] += noise(2, 0.1)
  qpos[:, 21:23] += noise(2, 0.3)
  ball = qpos[:, 23:27] + noise(4, 0.2)
  qpos[:, 23:27] = ball / ball.norm(dim=-1, keepdim=True)
  sim.data.qvel.add_(noise(model.nv, 0.2))
  sim.data.ctrl.copy_(noise(model.nu, 0.5))
  sim.data.act.copy_(noise(model.na, 0.5))
  sim.data.xfrc_applied.copy_(noise(6 * model.nbody, 0.1).reshape(n, -1, 6))
  sim.data.qfrc_applied.copy_(noise(model.nv, 0.1))
  sim.data.mocap_pos.add_(noise(3, 0.2)[:, None])


def reference(sim: Simulation, world: int) -> tuple[mujoco.MjModel, mujoco.MjData]:
  """Return MuJoCo C in the state of one world, with nothing computed yet."""
  data = mujoco.MjData(sim.mj_model)
  for name in "qpos qvel act ctrl qacc_warmstart xfrc_applied qfrc_applied mocap_pos mocap_quat".split():
    getattr(data, name)[:] = getattr(sim.data, name)[world].double().numpy()
  data.time = float(sim.data.time[world])
  return sim.mj_model, data
