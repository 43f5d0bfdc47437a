"""A small environment for viewers: boxes that fall and slide, one MjData each."""

from typing import Any

import mujoco
import numpy as np
import torch
from mjlab_core import DebugDraw

BOX = """
<mujoco>
  <option timestep="0.02"/>
  <statistic extent="2"/>
  <visual><quality shadowsize="512"/></visual>
  <asset>
    <mesh name="wedge" vertex="0 0 0  0.2 0 0  0 0.2 0  0 0 0.2"/>
    <mesh name="spike" vertex="0 0 0  0.05 0 0  0 0.05 0  0 0 0.6"/>
  </asset>
  <worldbody>
    <light pos="0 0 4" dir="0 0 -1"/>
    <geom name="floor" type="plane" size="5 5 0.1" rgba="0.5 0.5 0.5 1"/>
    <body name="box" pos="0 0 0.5">
      <freejoint/>
      <geom name="box" type="box" size="0.2 0.2 0.2" mass="1" rgba="0.9 0.1 0.1 1"/>
      <geom name="ornament" type="mesh" mesh="wedge" pos="0 0 0.2" rgba="0 0.9 0 1"
            contype="0" conaffinity="0" mass="0"/>
    </body>
  </worldbody>
</mujoco>
"""


GROUND = """
<mujoco>
  <statistic extent="1" center="0 0 0"/>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1=".3 .4 .6" rgb2=".7 .8 .9" width="32" height="192"/>
    <texture name="ground" type="2d" builtin="checker" rgb1=".2 .3 .4" rgb2=".1 .2 .3" width="100" height="100"/>
    <material name="ground" texture="ground" texuniform="true" reflectance=".2"/>
  </asset>
  <worldbody>
    <light type="directional" pos="0 0 3" dir=".2 .1 -1"/>
    <geom type="plane" size="0 0 .01" material="ground"/>
    <body pos="0 0 .5"><freejoint/><geom type="box" size=".2 .1 .1" rgba=".9 .1 .1 1"/></body>
  </worldbody>
</mujoco>"""


class BoxData:
  """Fields of all worlds. Velocities and forces can be written, other fields are copies."""

  def __init__(self, datas: list[mujoco.MjData]) -> None:
    self._datas = datas
    self.qvel = torch.zeros(len(datas), datas[0].qvel.size, dtype=torch.float64)
    self.xfrc_applied = torch.zeros(len(datas), *datas[0].xfrc_applied.shape, dtype=torch.float64)

  def __getattr__(self, name: str) -> torch.Tensor:
    return torch.from_numpy(np.stack([np.array(getattr(data, name)) for data in self._datas]))


class BoxSim:
  def __init__(self, num_envs: int) -> None:
    self.num_envs = num_envs
    self.device = torch.device("cpu")
    self.mj_model: mujoco.MjModel = mujoco.MjModel.from_xml_string(BOX)
    self.datas = [mujoco.MjData(self.mj_model) for _ in range(num_envs)]
    self.data = BoxData(self.datas)
    self.model: dict[str, torch.Tensor] = {}
    self.known_contacts: dict[int, Any] = {}
    """Contacts by world; viewers compute those of other worlds from the state."""

  def contacts(self, world: int) -> Any:
    return self.known_contacts.get(world)

  @property
  def expanded_fields(self) -> tuple[str, ...]:
    return tuple(self.model)

  def expand(self, name: str) -> torch.Tensor:
    """Give a model field one writable value per world."""
    value = torch.from_numpy(np.array(getattr(self.mj_model, name)))
    self.model[name] = value.expand(self.num_envs, *value.shape).clone()
    return self.model[name]


class SpeedCommand:
  """A command of two numbers with manual values and a drawing."""

  axes = (("forward", -1.0, 1.0), ("left", -0.5, 0.5))

  def __init__(self, env: "BoxEnv") -> None:
    self.env = env
    self.manual: dict[int, tuple[float, ...]] = {}

  def steer(self, world: int, values: Any) -> None:
    self.manual.pop(world, None)
    if values is not None:
      self.manual[world] = tuple(values)

  def debug_draw(self, draw: DebugDraw) -> None:
    start = self.env.sim.data.xpos[list(draw.worlds), 1]
    draw.arrows(start, start + torch.tensor([0.0, 0.0, 1.0]), (0.0, 1.0, 0.0, 1.0), 0.05)


class BoxEnv:
  """World i starts at x = i. An action pushes the box along x; an episode ends after `length` steps."""

  step_dt = 0.02

  def __init__(self, num_envs: int = 2, length: int = 1000) -> None:
    self.sim = BoxSim(num_envs)
    self.num_envs = num_envs
    self.length = length
    self.age = torch.zeros(num_envs, dtype=torch.int64)
    self.rewards = torch.zeros(num_envs, 2)
    self.ended = torch.zeros(num_envs, 2, dtype=torch.bool)
    self.command = SpeedCommand(self)
    self.num_resets = 0
    self.draws_at_first = False
    self.reset()

  def signals(self) -> dict[str, tuple[list[str], torch.Tensor]]:
    return {
      "rewards": (["height", "age"], self.rewards),
      "terminations": (["fell_over", "too_old"], self.ended),
      "observations actor": (["along", "across", "above"], self.sim.data.qpos[:, :3]),
    }

  def drawers(self) -> dict[str, Any]:
    return {"command speed": self.command.debug_draw}

  def default_drawers(self) -> tuple[str, ...]:
    return ("command speed",) if self.draws_at_first else ()

  def steering(self) -> dict[str, Any]:
    return {"speed": self.command}

  def reset(self) -> Any:
    self.num_resets += 1
    for world in range(self.num_envs):
      self._begin(world)
    return self.get_observations(), {}

  def step(self, action: torch.Tensor) -> Any:
    for world, data in enumerate(self.sim.datas):
      data.qvel[:] = self.sim.data.qvel[world].numpy()
      data.xfrc_applied[:] = self.sim.data.xfrc_applied[world].numpy()
      data.qfrc_applied[0] = float(action[world, 0])
      mujoco.mj_step(self.sim.mj_model, data)
      # Derived quantities describe the new state.
      mujoco.mj_forward(self.sim.mj_model, data)
      self.sim.data.qvel[world] = torch.from_numpy(data.qvel)
    self.age += 1
    done = self.age >= self.length
    self.ended[:, 1] = done
    for world in range(self.num_envs):
      self.rewards[world] = torch.tensor([self.sim.datas[world].qpos[2], float(self.age[world])])
      if done[world]:
        self._begin(world)
    return self.get_observations(), self.rewards.sum(1), torch.zeros_like(done), done, {}

  def get_observations(self) -> dict[str, torch.Tensor]:
    return {"actor": self.sim.data.qpos.float()}

  def _begin(self, world: int) -> None:
    data = self.sim.datas[world]
    mujoco.mj_resetData(self.sim.mj_model, data)
    data.qpos[0] = world
    mujoco.mj_forward(self.sim.mj_model, data)
    self.sim.data.qvel[world] = 0.0
    self.age[world] = 0
