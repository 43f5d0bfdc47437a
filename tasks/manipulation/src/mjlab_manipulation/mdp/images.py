"""Camera images as observations, channels first."""

from typing import TYPE_CHECKING, Literal, get_args

import mujoco
import torch
from mjlab_core import check_name, require
from mjlab_envs.mdp.readings import image_of
from mjlab_managers import ManagerTermBase, Reading, TermSource
from mjlab_sim import DataType

from mjlab_manipulation.mdp.stages import lift_command

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

Channel = Literal["rgb", "depth", "valid", "object"]

DATA_OF_CHANNEL: dict[Channel, DataType] = {
  "rgb": "rgb",
  "depth": "depth",
  "valid": "depth",
  "object": "segmentation",
}
"""Data type of the camera for each channel."""


class camera_image(ManagerTermBase):
  """Channels of an image in their order, each in [0, 1], (num_envs, channels, height, width).

  - "rgb": three channels, colour / 255;
  - "depth": along the optical axis, clamped to `depth_range` [m], over its upper end; 1 without a surface;
  - "valid": 1 where a surface is visible within `depth_range`, 0 elsewhere;
  - "object": 1 where the object of the lift command is visible.

  Raises:
    MjlabError: A channel does not exist or is not in the sensor's data, or the command is missing.
  """

  env: "ManagerBasedRlEnv"

  def __init__(
    self,
    env: "ManagerBasedRlEnv",
    *,
    sensor: str,
    channels: tuple[Channel, ...],
    depth_range: tuple[float, float] = (0.01, 0.5),
    command: str | None = None,
  ) -> None:
    super().__init__(env)
    for channel in channels:
      check_name("channel", channel, get_args(Channel))
      check_name("image", DATA_OF_CHANNEL[channel], env.scene[sensor].cfg.data_types, f"sensor '{sensor}'")
    self._sensor, self._channels, self._depth_range = env.scene[sensor], channels, depth_range
    if "object" in channels:
      self._lift = lift_command(env, require(command, str, "channel 'object' requires `command`, the lift command"))
      objects = self._lift.cfg.objects
      self._is_geom_of = torch.zeros(1, len(objects), env.sim.mj_model.ngeom, dtype=torch.bool, device=env.device)
      for i, name in enumerate(objects):
        self._is_geom_of[0, i, env.scene[name].indexing.ids["geom"].tolist()] = True

  def source(self) -> TermSource:
    (near, far), channels = self._depth_range, self._channels
    name = f"camera/{self._sensor.name}"
    needed: dict[str, Reading] = {}
    if "rgb" in channels:
      needed["rgb"] = image_of(self._sensor, "rgb", lambda: self._sensor.data.rgb_float)
    if {"depth", "valid"} & set(channels):
      needed["depth"] = image_of(self._sensor, "depth", lambda: self._sensor.data.depth)
    if "object" in channels:
      start = sum(3 if channel == "rgb" else 1 for channel in channels[: channels.index("object")])
      needed["object"] = Reading(name=f"{name}/object_mask", read=lambda: self()[:, start : start + 1])

    def compute(*images: torch.Tensor) -> torch.Tensor:
      seen = dict(zip(needed, images, strict=True))
      parts: list[torch.Tensor] = []
      for channel in channels:
        is_depth = channel in ("depth", "valid")
        parts.append(_of_depth(channel, seen["depth"], near, far) if is_depth else seen[channel])
      return torch.cat(parts, dim=1)

    return TermSource(readings=tuple(needed.values()), compute=compute)

  def __call__(self) -> torch.Tensor:
    data, (near, far) = self._sensor.data, self._depth_range
    images: list[torch.Tensor] = []
    for channel in self._channels:
      if channel == "rgb":
        images.append(data.rgb_float)
      elif channel in ("depth", "valid"):
        images.append(_of_depth(channel, data.depth, near, far))
      else:
        target = self._lift.of_target(self._is_geom_of.expand(self.num_envs, -1, -1))
        number, kind = data.segmentation.unbind(1)
        is_of_target = target.gather(1, number.flatten(1).clamp(0, target.shape[1] - 1).long()).view_as(number)
        images.append((is_of_target & (kind == int(mujoco.mjtObj.mjOBJ_GEOM))).float()[:, None])
    return images[0] if len(images) == 1 else torch.cat(images, dim=1)


def _of_depth(channel: Channel, depth: torch.Tensor, near: float, far: float) -> torch.Tensor:
  """Return depth between `near` and `far` as a share of `far`, or for "valid" 1 where it is between them."""
  if channel == "valid":
    return ((depth >= near) & (depth <= far)).float()
  return torch.where(depth < 0.0, far, depth).clamp(near, far) / far
