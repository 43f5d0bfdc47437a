"""Heights of the ground, seen by MuJoCo's rays from above."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np


class Ground:
  """The compiled model of a spec, to which a terrain was added."""

  def __init__(self, spec: mujoco.MjSpec) -> None:
    self.model: Any = spec.compile()
    self.data = mujoco.MjData(self.model)
    mujoco.mj_forward(self.model, self.data)

  def surface(self, points: np.ndarray) -> np.ndarray:
    """Heights at which rays meet geoms of group 0, at (n, 2) points, (n,) [m]; nan where they meet none."""
    down, geom = np.array((0.0, 0.0, -1.0)), np.zeros(1, dtype=np.int32)
    only_ground = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)
    out = []
    for x, y in points[:, :2]:
      distance = mujoco.mj_ray(self.model, self.data, np.array((x, y, 20.0)), down, only_ground, 1, -1, geom)
      out.append(20.0 - distance if distance >= 0.0 else np.nan)
    return np.array(out)

  def at(self, x: float, y: float) -> float:
    """Height of one point [m]."""
    return float(self.surface(np.array([[x, y]]))[0])


class Added(Ground):
  """A terrain in a separate model."""

  def __init__(self, cfg: Any, **options: Any) -> None:
    spec = mujoco.MjSpec()
    self.terrain = cfg.add_to(spec, **options)
    super().__init__(spec)
