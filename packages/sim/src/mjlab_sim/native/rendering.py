"""The batch renderer on a CPU, fed with results of MuJoCo's own engine."""

import copy
from collections.abc import Callable

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from mjlab_core import MjlabError
from mujoco import batch

from mjlab_sim.warp.launching import Stage
from mjlab_sim.warp.rendering import Renderers

wp.config.log_level = wp.LOG_WARNING

_DRAWN = """geom_dataid geom_matid geom_size geom_rgba cam_fovy cam_intrinsic light_type light_castshadow light_active
light_attenuation light_cutoff light_exponent light_ambient light_diffuse light_specular mat_texid mat_texuniform
mat_texrepeat mat_emission mat_specular mat_shininess mat_rgba""".split()
"""Per-world fields of the model that an image depends on, without those that become poses."""

_POSES = ("geom_xpos", "geom_xmat", "cam_xpos", "cam_xmat", "light_xpos", "light_xdir", "flexvert_xpos")
"""Fields of the data that MuJoCo Warp's renderer reads."""

_OPTIONS = ("solver", "integrator", "jacobian", "disableflags", "enableflags")


def native_renderers(
  model: mujoco.MjModel, batched: batch.Batch, data_field: Callable[[str], torch.Tensor]
) -> Renderers:
  """Return MuJoCo Warp's renderers of the worlds of a batch, which are copied before each image.

  Args:
    model: The compiled model.
    batched: All worlds.
    data_field: Gives a field of MjData, (num_envs, ...).

  Raises:
    MjlabError: MuJoCo Warp does not know something that the model contains.
  """
  wp.init()
  device, worlds, model = wp.get_device("cpu"), batched.nsim, copy.copy(model)
  # Nothing is stepped here: options of a step must not keep a model from being drawn.
  for name in _OPTIONS:
    setattr(model.opt, name, getattr(mujoco.MjOption(), name))
  with wp.ScopedDevice(device):
    try:
      m = mjw.put_model(model)
    except (NotImplementedError, ValueError) as error:
      raise MjlabError(f"MuJoCo Warp, which draws images on a CPU too, cannot take this model: {error}") from error
    d = mjw.make_data(model, nworld=worlds, nconmax=1, njmax=1)
  copies = [(getattr(d, name).numpy(), data_field(name).numpy()) for name in _POSES]

  def refresh() -> None:
    for target, source in copies:
      np.copyto(target, source, casting="same_kind")
    for name in _DRAWN:
      rows = batched.expanded(name)
      if rows is None:
        continue
      array = getattr(m, name)
      if array.shape[0] != worlds:
        array = wp.zeros((worlds, *array.shape[1:]), dtype=array.dtype, device=device)
        setattr(m, name, array)
      np.copyto(array.numpy(), rows, casting="same_kind")

  def run(name: str, launches: Callable[[], None]) -> None:
    with wp.ScopedDevice(device):
      launches()

  return Renderers(Stage(model, worlds, m, d, device, run, refresh))
