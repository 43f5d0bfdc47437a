"""MuJoCo Warp: thousands of worlds on a GPU, and the same code on a CPU for parity."""

import dataclasses
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from mjlab_core import ConfigError, Contacts, MjlabError, where_
from mjlab_core.torch_internals import version_of

from mjlab_sim.config import SimulationCfg
from mjlab_sim.fields import CONSTANTS, owner_of
from mjlab_sim.rays import Rays, RayTargets
from mjlab_sim.rendering import Draw, View
from mjlab_sim.tensors import TorchArray, versions
from mjlab_sim.warp import engine_kernels as kernels
from mjlab_sim.warp import internals
from mjlab_sim.warp.buffers import resize, starting_sizes
from mjlab_sim.warp.collision.grouped_broadphase import grouped_broadphase
from mjlab_sim.warp.collision.height_fields import height_field_collisions
from mjlab_sim.warp.constants.inverse_weights import InverseWeights
from mjlab_sim.warp.contacts import WarpContacts
from mjlab_sim.warp.kernel_loading import load_kernels
from mjlab_sim.warp.launching import Launcher, Stage, check_capture
from mjlab_sim.warp.overflow import Overflow
from mjlab_sim.warp.rays import RayScene, WarpRayCaster
from mjlab_sim.warp.rendering import Renderers
from mjlab_sim.warp.solver.fused_newton import choose_solver

wp.config.log_level = wp.LOG_WARNING

_PLACES = ("geom_pos", "geom_quat", "body_pos", "body_quat")

_ACCELERATION_STAGE = """actuator_force qfrc_actuator qfrc_smooth qfrc_constraint qfrc_inverse qacc_smooth cacc cfrc_int
cfrc_ext""".split()


def _tensor(array: wp.array) -> TorchArray:
  return TorchArray.over(lambda: wp.to_torch(array, requires_grad=False))


class WarpEngine:
  """MuJoCo Warp behind the engine protocol."""

  dtype = torch.float32

  def __init__(self, model: mujoco.MjModel, num_envs: int, cfg: SimulationCfg, device: torch.device) -> None:
    wp.init()
    self._wp_device = wp.device_from_torch(device)
    self._num_envs = num_envs
    self._mj_model = model
    self._contacts: WarpContacts | None = None
    self._data_views: dict[str, TorchArray] = {}
    self._model_views: dict[str, TorchArray] = {}
    self._expanded: set[str] = set()
    self._shared_version = 0
    if cfg.capture:
      check_capture(self._wp_device)
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
      raise ConfigError(
        "integrator RK4 does not allow MuJoCo Warp to split a step around the control; choose 'implicitfast',"
        " 'implicit' or 'euler'"
      )
    # Otherwise the sensor would report whether a frame is inside instead of how far a body reaches out.
    enclosed = (model.sensor_type == mujoco.mjtSensor.mjSENS_INSIDESITE) & (model.sensor_intprm[:, 0] != 0)
    for sensor in np.flatnonzero(enclosed):
      raise MjlabError(
        f"sensor '{model.sensor(sensor).name}': MuJoCo Warp knows no insidesite sensor with enclosed=\"true\";"
        " use it without, or the native engine"
      )
    with wp.ScopedDevice(self._wp_device):
      self._put(model, cfg)
      self._mask = wp.zeros(num_envs, dtype=wp.bool)
      # Bodies of the model, none of them welded to the world.
      self._no_weld = wp.ones(model.nbody, dtype=int)
      self._find_acceleration_sensors(model)
      self._overflow = Overflow(self._d, cfg)
      self._fused = choose_solver(self._m, self._d, cfg.solver_backend)
      self._broadphase = grouped_broadphase(model, self._m, self._d) if cfg.broadphase is None else None
      self._height_fields = height_field_collisions(self._m, self._d)
    self._mask_torch = wp.to_torch(self._mask)
    self._inverse_weights = InverseWeights(model, self._m, self._d)
    self._launcher = Launcher(self._d, device, capture=cfg.capture)
    self._run = self._launcher.run
    stage = Stage(model, num_envs, self._m, self._d, self._wp_device, self._run)
    self._rays, self._renderers = RayScene(stage), Renderers(stage)
    self._load_kernels()
    self.forward(model_changed=False)

  def _put(self, model: mujoco.MjModel, cfg: SimulationCfg) -> None:
    """Make MuJoCo Warp's model and data, with the options and buffer sizes of `cfg`."""
    host = mujoco.MjData(model)
    mujoco.mj_forward(model, host)
    sizes = starting_sizes(model) if "auto" in (cfg.nconmax, cfg.njmax) else {}
    sizes |= {name: size for name in ("nconmax", "njmax") if (size := getattr(cfg, name)) != "auto"}
    try:
      self._m = mjw.put_model(model)
      self._d = mjw.put_data(model, host, nworld=self._num_envs, **sizes)
    except (NotImplementedError, ValueError) as error:
      raise ConfigError(
        f"MuJoCo Warp cannot run this model: {error} Its solvers are 'newton' and 'cg'. Change the option or the model,"
        " or use engine 'native' on a CPU."
      ) from error
    option = self._m.opt
    option.contact_sensor_maxmatch = cfg.contact_sensor_maxmatch
    if cfg.broadphase is not None:
      option.broadphase = mjw.BroadphaseType[cfg.broadphase.upper()]
    if cfg.broadphase_filter is not None:
      tests = sum(mjw.BroadphaseFilter[name.upper()] for name in cfg.broadphase_filter)
      option.broadphase_filter = mjw.BroadphaseFilter(tests)
    # Printing from the device is slow and floods the terminal; overflow is counted instead.
    option.warn_overflow = 0

  def _find_acceleration_sensors(self, model: mujoco.MjModel) -> None:
    """Note the columns of sensors that belong to the acceleration stage, and make memory for their readings."""
    columns = np.repeat(model.sensor_needstage == mujoco.mjtStage.mjSTAGE_ACC, model.sensor_dim)
    self._has_acceleration_sensors = bool(columns.any())
    self._is_acceleration = wp.array(columns, dtype=wp.bool)
    self._saved_sensors = wp.zeros((self._num_envs, model.nsensordata), dtype=wp.float32)

  def _load_kernels(self) -> None:
    # Most environments change a constant at their first reset; loading these kernels beside the rest costs no time.
    stages = [self._forward, self._step, self._reset, lambda: self._recompute(list(CONSTANTS), places=True)]
    # Copies and fills are not kernels, and do happen.
    with self._launcher.stream(), self._launcher.preserved():
      load_kernels(stages, self._wp_device)

  # Fields

  def data_field(self, name: str) -> TorchArray:
    if name not in self._data_views:
      array = getattr(self._d, name, None)
      if not isinstance(array, wp.array) or array.shape[0] != self._num_envs:
        raise KeyError(name)
      self._data_views[name] = _tensor(array)
    return self._data_views[name]

  def model_field(self, name: str) -> TorchArray:
    if name not in self._model_views:
      self._model_views[name] = _tensor(getattr(*owner_of(self._m, name)))
    return self._model_views[name]

  def expand(self, name: str) -> None:
    self._expanded.add(name)
    owner, attribute = owner_of(self._m, name)
    shared = getattr(owner, attribute)
    if shared.shape[0] == self._num_envs:
      return
    with wp.ScopedDevice(self._wp_device):
      rows = wp.zeros((self._num_envs, *shared.shape[1:]), dtype=shared.dtype)
    view = _tensor(rows)
    view.copy_(self.model_field(name))
    setattr(owner, attribute, rows)
    self._model_views[name] = view
    self._launcher.clear()

  # Stages

  def step(self) -> None:
    self._run("step", self._step)

  def forward(self, model_changed: bool) -> None:
    # Every world is recomputed; a world without writes gets the same values.
    places = model_changed and self._has_moved()
    self._run(f"forward {places}", lambda: self._forward(places))

  def reset(self, mask: torch.Tensor) -> None:
    self._mask_torch.copy_(mask)
    self._run("reset", self._reset)
    # MuJoCo C clears these too. They belong to the substep before, and forward does not recompute them.
    for name in _ACCELERATION_STAGE:
      where_(self.data_field(name), mask, 0.0)
    if self._contacts is not None:
      self._contacts.forget(mask)

  def recompute_constants(self, mask: torch.Tensor | None) -> None:
    is_shared = self._shared_writes() != self._shared_version
    groups = [name for name, fields in CONSTANTS.items() if is_shared or not fields.isdisjoint(self._expanded)]
    if "INERT0" in groups and "KIN0" not in groups:
      # Weights are those of the reference pose, where the other group puts everything.
      groups.append("KIN0")
    if not groups:
      return
    if mask is None or is_shared:
      self._mask_torch.fill_(True)
    else:
      self._mask_torch.copy_(mask)
    fields = sorted(name for group in groups for name in CONSTANTS[group])
    # Most are derived for all worlds, in single precision: fields without a change must not change by a rounding.
    before = {name: self.model_field(name).clone() for name in fields}
    places = self._has_moved()
    self._run(f"constants {groups} {places}", lambda: self._recompute(groups, places))
    for name, value in before.items():
      if name not in self._expanded and not is_shared:
        self.model_field(name).copy_(value)
      elif name in self._expanded and mask is not None:
        where_(self.model_field(name), ~mask, value)
    self._shared_version = self._shared_writes()

  def _shared_writes(self) -> int:
    """Return a number that grows with every write to a field that all worlds share."""
    return versions(view for name, view in self._model_views.items() if name not in self._expanded)

  def _has_moved(self) -> bool:
    """Return True if geoms that never move by themselves may have been moved."""
    return any(name in self._model_views and version_of(self._model_views[name]) for name in _PLACES)

  def _step(self) -> None:
    # Touch is added up, and forces of limits are written where there are any: both count on columns that are zero.
    if self._has_acceleration_sensors:
      self._d.sensordata.zero_()
    with self._ours():
      mjw.step2(self._m, self._d)
    self._overflow.count()
    if self._contacts is not None:
      self._contacts.record()
    self._forward()

  def _forward(self, places: bool = False) -> None:
    if places:
      self._place()
    # step1 clears all of sensordata and computes only sensors of positions and velocities. The rest belongs
    # to the substep just done: it is copied and written back.
    if self._has_acceleration_sensors:
      wp.copy(self._saved_sensors, self._d.sensordata)
    with self._ours():
      mjw.step1(self._m, self._d)
    if self._has_acceleration_sensors:
      wp.launch(
        kernels.restore_acceleration_sensors,
        dim=self._saved_sensors.shape,
        inputs=[self._saved_sensors, self._is_acceleration],
        outputs=[self._d.sensordata],
      )

  def _ours(self) -> AbstractContextManager[None]:
    """Have MuJoCo Warp call the parts of a step that are ours."""
    calls = {}
    if self._fused is not None:
      calls["solve"] = self._fused.solve
    if self._broadphase is not None:
      calls["nxn_broadphase"] = self._broadphase.find_pairs
    if self._height_fields is not None:
      calls["convex_narrowphase"] = self._height_fields.narrowphase
    return internals.stepping_with(calls)

  def _reset(self) -> None:
    mjw.reset_data(self._m, self._d, self._mask)

  def _recompute(self, groups: list[str], places: bool) -> None:
    if places:
      self._place()
    # Kinematics are left at qpos0; the forward pass that follows recomputes them.
    is_ours = internals.IS_TESTED and "INERT0" in groups
    bits = sum(int(mjw.SetConstGroup[name]) for name in groups if not (is_ours and name == "INERT0"))
    mjw.set_const(self._m, self._d, groups=bits, restore=False)
    if is_ours:
      self._inverse_weights.compute(self._mask)

  def _place(self) -> None:
    """Put every geom where its body is; MuJoCo Warp leaves those of bodies that never move where they were compiled."""
    mjw.kinematics(dataclasses.replace(self._m, body_weldid=self._no_weld), self._d)

  def overflow_report(self) -> list[str]:
    return self._overflow.report()

  @property
  def buffer_sizes(self) -> dict[str, int]:
    return self._overflow.sizes

  def make_room(self, at_least: Mapping[str, int]) -> bool:
    sizes = self._overflow.wanted(at_least)
    if not sizes:
      return False
    # Kernels that run may still use the old memory.
    wp.synchronize_device(self._wp_device)
    self._launcher.clear()
    with self._launcher.stream():
      resize(self._mj_model, self._d, sizes)
      if self._contacts is not None:
        self._contacts.resize()
      self._overflow.note_growth(sizes)
    return True

  def ray_caster(self, targets: RayTargets, rays: Rays) -> Callable[[bool], None]:
    return WarpRayCaster(self._rays, targets, rays).cast

  def renderer(self, view: View, images: Mapping[str, torch.Tensor]) -> Draw:
    return self._renderers.add(view, images)

  def contacts(self, world: int) -> Contacts[torch.Tensor]:
    if self._contacts is None:
      self._contacts = WarpContacts(self._m, self._d)
      self._launcher.clear()
    return self._contacts.of(world)
