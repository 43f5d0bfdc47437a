"""What a policy sees through a camera, channels first."""

from typing import TYPE_CHECKING, Literal, get_args

import mujoco
import torch
from mjlab_core.names import unknown
from mjlab_managers import ManagerTermBase, ObservationTermCfg
from mjlab_sim import DataType

from mjlab_manipulation.mdp.rewards import lift_command

if TYPE_CHECKING:
  from mjlab_envs import ManagerBasedRlEnv

Channel = Literal["rgb", "depth", "valid", "object"]

DATA_OF_CHANNEL: dict[Channel, DataType] = {
  "rgb": "rgb",
  "depth": "depth",
  "valid": "depth",
  "object": "segmentation",
}
"""What a camera must draw for each channel."""


class camera_image(ManagerTermBase):
  """Channels of an image in their order, each in [0, 1], (num_envs, channels, height, width).

  - "rgb": three channels, colour / 255;
  - "depth": along the optical axis, limited to `depth_range` [m] and over its upper end; 1, far, where nothing is seen;
  - "valid": 1 where anything is seen within `depth_range`, 0 elsewhere;
  - "object": 1 where the object of the lift command is seen.

  Raises:
    ValueError: a channel that does not exist or that the sensor does not draw, an empty range, or no command.
  """

  _constants = frozenset({"_is_geom_of"})

  def __init__(self, cfg: ObservationTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    sensor, (near, far) = cfg.params["sensor"], cfg.params["depth_range"]
    for channel in cfg.params["channels"]:
      if channel not in get_args(Channel):
        raise ValueError(unknown("channel", channel, get_args(Channel)))
      if DATA_OF_CHANNEL[channel] not in env.scene[sensor].cfg.data_types:
        raise ValueError(
          f"channel '{channel}' needs '{DATA_OF_CHANNEL[channel]}' among the data_types of sensor '{sensor}'"
        )
    if not cfg.params["channels"]:
      raise ValueError(f"channels must name at least one of: {', '.join(get_args(Channel))}")
    if not 0.0 <= near < far:
      raise ValueError(f"depth_range must begin at 0 or more and end above, got {(near, far)}")
    if "object" in cfg.params["channels"]:
      if cfg.params["command"] is None:
        raise ValueError("channel 'object' needs the lift command: give command")
      objects = lift_command(env, cfg.params["command"]).cfg.objects
      self._is_geom_of = torch.zeros(1, len(objects), env.sim.mj_model.ngeom, dtype=torch.bool, device=env.device)
      for i, name in enumerate(objects):
        self._is_geom_of[0, i, env.scene[name].indexing.ids["geom"].tolist()] = True

  def __call__(
    self,
    env: "ManagerBasedRlEnv",
    *,
    sensor: str,
    channels: tuple[Channel, ...],
    depth_range: tuple[float, float] = (0.01, 0.5),
    command: str | None = None,
  ) -> torch.Tensor:
    data, (near, far) = env.scene[sensor].data, depth_range
    images: list[torch.Tensor] = []
    for channel in channels:
      if channel == "rgb":
        images.append(data.rgb_float)
      elif channel == "depth":
        images.append(torch.where(data.depth < 0.0, far, data.depth).clamp(near, far) / far)
      elif channel == "valid":
        images.append(((data.depth >= near) & (data.depth <= far)).float())
      else:
        assert command is not None
        target = lift_command(env, command).of_target(self._is_geom_of.expand(env.num_envs, -1, -1))
        number, kind = data.segmentation.unbind(1)
        is_of_target = target.gather(1, number.flatten(1).clamp(0, target.shape[1] - 1).long()).view_as(number)
        images.append((is_of_target & (kind == int(mujoco.mjtObj.mjOBJ_GEOM))).float()[:, None])
    return images[0] if len(images) == 1 else torch.cat(images, dim=1)
