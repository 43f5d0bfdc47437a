"""Entities and types that tests share."""

from collections.abc import Callable
from typing import Any

import mujoco
from mjlab_scene import EntityCfg, Scene
from mjlab_sim import Simulation

MakeWorlds = Callable[..., tuple[Scene, Simulation]]


def entity(xml: str, **fields: Any) -> EntityCfg:
  """Return the config of an entity of this MJCF."""
  return EntityCfg(spec_fn=lambda: mujoco.MjSpec.from_string(xml), **fields)
