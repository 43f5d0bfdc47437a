"""One engine as the oracle of the other, and what a step of the scene costs."""

from collections.abc import Callable

import pytest
import torch
from mjlab_actuators import NativePositionActuatorCfg
from mjlab_scene import EntityArticulationCfg, EntityData, Scene, SceneCfg
from mjlab_sim import Simulation
from mjlab_terrain import PlaneCfg
from scene_models import MakeWorlds, entity
from torch.utils._python_dispatch import TorchDispatchMode

LEG = """
<mujoco>
  <worldbody>
    <body name="trunk" pos="0 0 .8">
      <freejoint/>
      <geom name="trunk" size=".1" pos=".03 0 0"/>
      <site name="imu" pos="0 .1 0"/>
      <body name="thigh"><joint name="hip" axis="0 1 0"/><geom name="thigh" size=".05" pos="0 0 -.2"/>
        <body name="shank" pos="0 0 -.3"><joint name="knee" axis="0 1 0"/><geom size=".05" pos="0 0 -.2"/></body>
      </body>
    </body>
  </worldbody>
  <tendon><fixed name="rope"><joint joint="hip" coef="1"/></fixed></tendon>
</mujoco>
"""


def scene_cfg(num_envs: int = 2) -> SceneCfg:
  servo = NativePositionActuatorCfg(target_names_expr=(".*",), stiffness=20.0, damping=1.0)
  robot = entity(LEG, articulation=EntityArticulationCfg(actuators=(servo,)))
  post = entity('<mujoco><worldbody><geom name="post" size=".1"/></worldbody></mujoco>')
  return SceneCfg(num_envs=num_envs, terrain=PlaneCfg(), entities={"robot": robot, "post": post})


def run(scene: Scene, sim: Simulation) -> None:
  robot = scene["robot"]
  velocity = torch.tensor([[0.3, -0.2, 0.1, 0.5, -0.4, 0.3]], dtype=sim.dtype, device=sim.device)
  robot.write_root_velocity(velocity, torch.tensor([False, True]))
  robot.write_external_wrench(
    torch.ones((1, 1, 3), dtype=sim.dtype), torch.ones((1, 1, 3), dtype=sim.dtype), body_ids=[1]
  )
  robot.set_joint_position_target(torch.full((2, 1), 0.4, dtype=sim.dtype), joint_ids=[1])
  for _ in range(5):
    scene.write_ctrl()
    sim.step()
    scene.update(sim.timestep)
  mask = torch.tensor([True, False])
  sim.reset(mask)
  scene.reset(mask)
  scene.write_default_state(mask)


@pytest.mark.warp
def test_both_engines_agree_on_every_quantity(make_worlds: MakeWorlds) -> None:
  native, warp = (make_worlds(engine=engine, cfg=scene_cfg()) for engine in ("native", "warp"))
  for scene, sim in (native, warp):
    run(scene, sim)
  assert (native[1].dtype, warp[1].dtype) == (torch.float64, torch.float32)
  names = [
    name
    for cls in EntityData.__mro__
    for name, member in vars(cls).items()
    if isinstance(member, property) and not name.startswith("_")
  ]
  # Those of the acceleration stage of a world that was just reset are the engine's own affair.
  acceleration = {"joint_acc", "actuator_force", "qfrc_actuator"}
  for part in ("robot", "post"):
    for name in names:
      expected, actual = (getattr(scene[part].data, name) for scene, _ in (native, warp))
      rows = slice(1, None) if name in acceleration else slice(None)
      torch.testing.assert_close(
        actual[rows].double(), expected[rows], rtol=2e-4, atol=2e-4, msg=lambda m, n=name: f"{n}: {m}"
      )


class _Count(TorchDispatchMode):
  count = 0

  def __torch_dispatch__(self, func, types, args=(), kwargs=None):
    if not func.is_view:
      self.count += 1
    return func(*args, **(kwargs or {}))


def kernels(call: Callable[[], object]) -> int:
  """How many torch operations that are not mere views a call makes."""
  with _Count() as counter:
    call()
  return counter.count


def test_quantities_cost_few_operations(make_worlds: MakeWorlds) -> None:
  scene, sim = make_worlds(cfg=scene_cfg())
  data = scene["robot"].data
  budget = {"joint_pos": 0, "root_link_pose_w": 0, "root_link_ang_vel_b": 0, "body_link_pos_w": 0, "joint_acc": 0}
  budget |= {"projected_gravity_b": 1, "heading_w": 1, "root_link_lin_vel_b": 2, "soft_joint_pos_limits": 0}
  budget |= {"body_link_lin_vel_w": 4}
  for name, allowed in budget.items():
    sim.data.qpos.add_(0.0)
    _ = sim.version
    assert kernels(lambda name=name: getattr(data, name)) <= allowed, name
    assert kernels(lambda name=name: getattr(data, name)) == 0, name


def test_a_servo_costs_one_operation_in_the_first_substep_and_none_after(make_worlds: MakeWorlds) -> None:
  scene, _ = make_worlds(cfg=scene_cfg())
  scene["robot"].set_joint_position_target(torch.ones((2, 2), dtype=torch.float64))
  assert kernels(scene.write_ctrl) == 1
  assert kernels(scene.write_ctrl) == 0
