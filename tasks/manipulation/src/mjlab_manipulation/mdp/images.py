"""Camera images as observations, channels first."""

from functools import partial
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
    self._kinds: tuple[DataType, ...] = tuple(dict.fromkeys(DATA_OF_CHANNEL[channel] for channel in channels))
    if "object" in channels:
      self._lift = lift_command(env, require(command, str, "channel 'object' requires `command`, the lift command"))
      objects = self._lift.cfg.objects
      self._is_geom_of = torch.zeros(1, len(objects), env.sim.mj_model.ngeom, dtype=torch.bool, device=env.device)
      for i, name in enumerate(objects):
        self._is_geom_of[0, i, env.scene[name].indexing.ids["geom"].tolist()] = True

  def source(self) -> TermSource:
    readings: list[Reading] = []
    for kind in self._kinds:
      read = partial(self._read, kind)
      if kind == "rgb" or kind == "depth":
        readings.append(image_of(self._sensor, kind, read))
      else:
        readings.append(Reading(name=f"camera/{self._sensor.name}/object_mask", read=read))
    return TermSource(readings=tuple(readings), compute=self._compose)

  def __call__(self) -> torch.Tensor:
    return self._compose(*(self._read(kind) for kind in self._kinds))

  def _read(self, kind: DataType) -> torch.Tensor:
    """Return an image of the sensor; of a segmentation the mask of the object to lift."""
    data = self._sensor.data
    if kind != "segmentation":
      return data.rgb_float if kind == "rgb" else data.depth
    target = self._lift.of_target(self._is_geom_of.expand(self.num_envs, -1, -1))
    number, geom_or_other = data.segmentation.unbind(1)
    is_of_target = target.gather(1, number.flatten(1).clamp(0, target.shape[1] - 1).long()).view_as(number)
    return (is_of_target & (geom_or_other == int(mujoco.mjtObj.mjOBJ_GEOM))).float()[:, None]

  def _compose(self, *images: torch.Tensor) -> torch.Tensor:
    """Return the channels of images in the order of `_kinds`."""
    near, far = self._depth_range
    parts: list[torch.Tensor] = []
    for channel in self._channels:
      image = images[self._kinds.index(DATA_OF_CHANNEL[channel])]
      if channel == "valid":
        image = ((image >= near) & (image <= far)).float()
      elif channel == "depth":
        image = torch.where(image < 0.0, far, image).clamp(near, far) / far
      parts.append(image)
    return parts[0] if len(parts) == 1 else torch.cat(parts, dim=1)
