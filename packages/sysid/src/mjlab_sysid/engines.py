"""Engines that step many copies of a robot: MuJoCo's own batch on all cores, or MuJoCo Warp."""

from collections.abc import Callable, Iterable
from types import SimpleNamespace
from typing import Any, Literal

import mujoco
import numpy as np
import torch
from mjlab_core.errors import MjlabError
from mjlab_core.lazy import from_extra
from mujoco.batch import Batch, SimulationError

from mjlab_sysid.robot import Robot

EngineName = Literal["auto", "native", "warp"]


def make_engine(robot: Robot, num_worlds: int, engine: EngineName, device: str, threads: int) -> Any:
  """Return worlds with the interface of `mjlab_sim.Simulation`.

  Raises:
    MjlabError: The native engine is asked for on a GPU.
    ModuleNotFoundError: MuJoCo Warp is asked for without the extra 'warp'.
  """
  if engine == "native" or (engine == "auto" and device == "cpu"):
    if device != "cpu":
      raise MjlabError(f"engine 'native' runs on a CPU, the device is '{device}'; set device 'cpu' or engine 'warp'")
    return NativeWorlds(robot.model, num_worlds, threads)
  with from_extra("warp", "mjlab-sysid", "MuJoCo Warp"):
    from mjlab_sim import Simulation, SimulationCfg
  return Simulation(num_worlds, robot.spec, SimulationCfg(engine="warp", integrator=None), device)


class NativeWorlds:
  """Worlds of MuJoCo's batch, with the part of the interface of `mjlab_sim.Simulation` that a fit needs.

  A world that MuJoCo stops has NaN positions from then on.
  """

  engine = "native"
  device = torch.device("cpu")
  dtype = torch.float64

  def __init__(self, model: mujoco.MjModel, num_worlds: int, threads: int) -> None:
    self.num_envs, self.mj_model, self.timestep = num_worlds, model, float(model.opt.timestep)
    self._batch = Batch(model, num_worlds, threads)
    self.model = SimpleNamespace()
    self.data = _Data(self._batch)
    self._ok = np.ones(num_worlds, dtype=bool)

  def default_field(self, name: str, /) -> torch.Tensor:
    """Return the compiled value, (1, ...)."""
    value = getattr(self.mj_model.opt, name[4:]) if name.startswith("opt.") else getattr(self.mj_model, name)
    return torch.from_numpy(np.array(value)).unsqueeze(0)

  def expand_model_fields(self, names: Iterable[str], /) -> None:
    """Give these fields one value per world."""
    for name in names:
      if not hasattr(self.model, name):
        setattr(self.model, name, torch.from_numpy(self._batch.expand(name)))

  def recompute_constants(self, mask: torch.Tensor | None = None, /) -> None:
    """Run `mj_setConst` in all worlds."""
    del mask
    self._batch.set_const()

  def reset(self) -> None:
    """Set all worlds to the model's initial state."""
    self._batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
    self._ok[:] = True

  def step(self) -> None:
    """Advance all worlds by one timestep."""
    try:
      self._batch.step(ids=None if self._ok.all() else self._ok)
    except SimulationError as error:
      self._ok[error.ids] = False
      self.data.qpos[torch.from_numpy(~self._ok)] = torch.nan

  def capture(self, function: Callable[[], object]) -> Callable[[], object]:
    """Return the function, which an engine on a GPU records."""
    return function


class _Data:
  """Fields of MjData as tensors; state can be written."""

  def __init__(self, batch: Batch) -> None:
    self.qpos, self.qvel, self.ctrl = (torch.from_numpy(batch.bind(name)) for name in ("qpos", "qvel", "ctrl"))
    # An output is filled by steps after it is bound.
    self._efforts, self._sensors = batch.bind("qfrc_actuator"), batch.bind("sensordata")

  @property
  def qfrc_actuator(self) -> torch.Tensor:
    """Efforts of actuators of the last timestep, as a copy, (num_worlds, nv)."""
    return torch.from_numpy(self._efforts.copy())

  @property
  def sensordata(self) -> torch.Tensor:
    """Readings of sensors at the beginning of the last timestep, as a copy, (num_worlds, nsensordata)."""
    return torch.from_numpy(self._sensors.copy())
