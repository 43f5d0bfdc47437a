"""Models with actuators, which tests share."""

from typing import Any

import mujoco
import torch
from mjlab_actuators import ActuatorCfg, ActuatorSet


def chain(*joints: str, actuators: str = "") -> str:
  """Return the MJCF of links with a hinge each, one behind the other, and of these actuators."""
  links = "".join(f'<body><geom size="0.1"/><joint name="{joint}"/>' for joint in joints) + "</body>" * len(joints)
  return f"<mujoco><worldbody>{links}</worldbody><actuator>{actuators}</actuator></mujoco>"


def build(
  xml: str, *cfgs: ActuatorCfg, owner: str = "entity 'x'", **options: Any
) -> tuple[mujoco.MjModel, ActuatorSet]:
  """Return the model with the actuators of these configs; one world by default."""
  spec = mujoco.MjSpec.from_string(xml)
  actuators = ActuatorSet(cfgs, owner)
  actuators.edit_spec(spec)
  model = spec.compile()
  settings: dict[str, Any] = {"num_envs": 1, "device": "cpu", "dtype": torch.float64, **options}
  return model, actuators.build(model, **settings)
