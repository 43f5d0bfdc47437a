"""Example that drives a small model with a DC motor and a learned motor, in plain C MuJoCo.

It needs nothing but this package:
`uv run --no-project --with ./packages/actuators python packages/actuators/examples/plain_mujoco.py`.
"""

import tempfile
from pathlib import Path

import mujoco
import torch
from mjlab_actuators import ActuatorSet, DcMotorActuatorCfg, LearnedMlpActuatorCfg

TWO_WHEELS = """
<mujoco>
  <option timestep="0.002"/>
  <default><geom type="cylinder" size="0.1 0.01" density="8000"/></default>
  <worldbody>
    <body name="left"><joint name="left" axis="0 0 1" armature="0.05"/><geom/></body>
    <body name="right" pos="0.5 0 0"><joint name="right" axis="0 0 1" armature="0.05"/><geom/></body>
  </worldbody>
</mujoco>
"""
STIFFNESS, DAMPING, EFFORT_LIMIT, NO_LOAD_SPEED = 8.0, 0.9, 2.0, 6.0
HISTORY = 3


def train_network(path: Path, *, steps: int = 400) -> float:
  """Train a small network on a PD controller with a soft limit, save its state dict, and return its error [N m].

  It stands for one trained on the records of a real motor: rows of position errors and velocities, newest first.
  """
  generator = torch.Generator().manual_seed(0)
  torch.manual_seed(0)
  net = torch.nn.Sequential(torch.nn.Linear(2 * HISTORY, 32), torch.nn.Softsign(), torch.nn.Linear(32, 1))
  optimizer = torch.optim.Adam(net.parameters(), lr=0.02)
  error = torch.empty(())
  for _ in range(steps):
    # Successive samples of a motor are alike, so those of the training are.
    rows = torch.randn(512, 2, 1, generator=generator) + 0.02 * torch.randn(512, 2, HISTORY, generator=generator)
    wanted = STIFFNESS * rows[:, 0, 0] - DAMPING * rows[:, 1, 0]
    effort = EFFORT_LIMIT * torch.tanh(wanted / EFFORT_LIMIT)
    error = (net(rows.flatten(1))[:, 0] - effort).square().mean()
    optimizer.zero_grad()
    error.backward()
    optimizer.step()
  torch.save(net.state_dict(), path)
  return error.sqrt().item()


def main() -> None:
  with tempfile.TemporaryDirectory() as folder:
    network = Path(folder) / "motor.pt"
    print(f"network: error {train_network(network):.3f} N m")
    actuators = ActuatorSet(
      [
        DcMotorActuatorCfg(
          target_names_expr=("left",),
          stiffness=STIFFNESS,
          damping=DAMPING,
          saturation_effort=EFFORT_LIMIT,
          velocity_limit=NO_LOAD_SPEED,
        ),
        LearnedMlpActuatorCfg(
          target_names_expr=("right",),
          network_file=network,
          history_length=HISTORY,
          saturation_effort=EFFORT_LIMIT,
          velocity_limit=NO_LOAD_SPEED,
        ),
      ]
    )
    spec = mujoco.MjSpec.from_string(TWO_WHEELS)
    actuators.edit_spec(spec)
    model = spec.compile()
    actuators.build(model, num_envs=1, device="cpu", dtype=torch.float64)

  data = mujoco.MjData(model)
  target, zero = torch.full((1, 2), 2.0, dtype=torch.float64), torch.zeros(1, 2, dtype=torch.float64)
  actuators.reset(torch.ones(1, dtype=torch.bool), target, zero, zero)
  # Views of MuJoCo's own memory: nothing is copied but the torques.
  position, velocity = torch.from_numpy(data.qpos)[None], torch.from_numpy(data.qvel)[None]
  fastest = 0.0
  while data.time < 3.0:
    data.ctrl[list(actuators.ctrl_ids)] = actuators.compute(target, zero, zero, position, velocity)[0].numpy()
    mujoco.mj_step(model, data)
    fastest = max(fastest, data.qvel.max())
  print(f"fastest: {fastest:.2f} rad/s, no-load speed {NO_LOAD_SPEED} rad/s")
  for wheel, angle in zip(actuators.target_names, data.qpos, strict=True):
    print(f"{wheel}: {angle:.3f} rad after {data.time:.0f} s, target 2 rad")


if __name__ == "__main__":
  main()
