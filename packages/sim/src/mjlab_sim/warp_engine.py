"""MuJoCo Warp: thousands of worlds on a GPU, and the same code on a CPU for parity."""

import contextlib
import dataclasses
import itertools
from collections.abc import Callable, Generator
from typing import Any

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp
from mjlab_core.masking import where_
from mujoco_warp._src import smooth

from mjlab_sim import warp_kernels
from mjlab_sim.config import RK4_REFUSED, SimulationCfg
from mjlab_sim.errors import SimulationError
from mjlab_sim.fields import CONSTANTS, PER_WORLD
from mjlab_sim.graph import Recorder
from mjlab_sim.inverse_weights import InverseWeights
from mjlab_sim.kernel_loading import load_kernels
from mjlab_sim.rendering import View
from mjlab_sim.static_rays import RayTargets
from mjlab_sim.torch_array import TorchArray
from mjlab_sim.warp_contacts import WarpContacts
from mjlab_sim.warp_rays import FixedTriangles, Surfaces, WarpRayCaster
from mjlab_sim.warp_rendering import Stage, WarpRenderer

wp.config.log_level = wp.LOG_WARNING

_PLACES = ("geom_pos", "geom_quat", "body_pos", "body_quat")

# Bits of `overflow` that mean dropped physics, with what was short and the setting to raise.
_BUFFERS = (
  (mjw.OverflowType.NEFC, "constraint buffer", "njmax"),
  (mjw.OverflowType.NJMAX_NNZ, "sparse constraint buffer", "njmax"),
  (mjw.OverflowType.BROADPHASE, "candidate-pair buffer", "nconmax"),
  (mjw.OverflowType.NARROWPHASE, "contact buffer", "nconmax"),
  (mjw.OverflowType.CONTACT_MATCH, "contact-sensor match buffer", "contact_sensor_maxmatch"),
)
_OTHER = (
  (mjw.OverflowType.CCD, "convex collision ran out of its buffer", "nconmax"),
  (mjw.OverflowType.HFIELD, "a geom spans too many height-field cells; use coarser cells", None),
  (mjw.OverflowType.EPA_HORIZON, "convex collision gave up on a deep contact", None),
)


_ACCELERATION_STAGE = """actuator_force qfrc_actuator qfrc_smooth qfrc_constraint qfrc_inverse qacc_smooth cacc cfrc_int
cfrc_ext""".split()


class WarpEngine:
  """MuJoCo Warp behind the engine protocol."""

  dtype = torch.float32

  def __init__(self, model: mujoco.MjModel, num_envs: int, cfg: SimulationCfg, device: torch.device) -> None:
    wp.init()
    self._device = device
    self._wp_device = wp.device_from_torch(device)
    self._num_envs = num_envs
    self._mj_model = model
    self._capture = cfg.capture
    self._graphs: dict[str, Callable[[], None]] = {}
    self._fixed_triangles: dict[bytes, FixedTriangles] = {}
    self._surfaces: Surfaces | None = None
    self._contacts: WarpContacts | None = None
    self._data_views: dict[str, TorchArray] = {}
    self._model_views: dict[str, TorchArray] = {}
    self._caster_numbers = itertools.count()
    self._expanded: set[str] = set()
    # Memory for what derived fields were before they are computed anew.
    self._before: dict[str, torch.Tensor] = {}
    self._shared_version = 0
    if cfg.capture:
      check_capture(self._wp_device)
    if model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
      raise SimulationError("the model asks for integrator RK4; " + RK4_REFUSED)
    # It would tell whether a frame is inside instead of how far a body reaches out.
    enclosed = (model.sensor_type == mujoco.mjtSensor.mjSENS_INSIDESITE) & (model.sensor_intprm[:, 0] != 0)
    for sensor in np.flatnonzero(enclosed):
      raise SimulationError(
        f"sensor '{model.sensor(sensor).name}': MuJoCo Warp knows no insidesite sensor with enclosed=\"true\";"
        " use it without, or the native engine"
      )
    host = mujoco.MjData(model)
    mujoco.mj_forward(model, host)
    with wp.ScopedDevice(self._wp_device):
      try:
        self._m = mjw.put_model(model)
        self._d = mjw.put_data(model, host, nworld=num_envs, nconmax=cfg.nconmax, njmax=cfg.njmax)
      except (NotImplementedError, ValueError) as error:
        raise SimulationError(f"MuJoCo Warp cannot run this model: {error}") from error
      self._m.opt.contact_sensor_maxmatch = cfg.contact_sensor_maxmatch
      # Printing from the device is slow and floods the terminal; overflow is counted instead.
      self._m.opt.warn_overflow = 0
      self._mask = wp.zeros(num_envs, dtype=wp.bool)
      columns = np.zeros(model.nsensordata, dtype=bool)
      for adr, dim, stage in zip(model.sensor_adr, model.sensor_dim, model.sensor_needstage, strict=True):
        columns[adr : adr + dim] = stage == mujoco.mjtStage.mjSTAGE_ACC
      self._has_acceleration_sensors = bool(columns.any())
      self._is_acceleration = wp.array(columns, dtype=wp.bool)
      self._saved_sensors = wp.zeros((num_envs, model.nsensordata), dtype=wp.float32)
      self._ones = wp.ones(model.nbody, dtype=wp.int32)
      self._overflow_seen = wp.zeros(num_envs, dtype=wp.int32)
      self._overflow_wanted = wp.zeros(3, dtype=wp.int32)
    self._mask_torch = wp.to_torch(self._mask)
    self._inverse_weights = InverseWeights(model, self._m, self._d)
    self._stage = Stage(model, num_envs, self._m, self._d, self._wp_device, self._run, refresh=lambda: None)
    stages = [self._forward, self._step, self._reset, self._count_overflow]
    # Most environments change a constant at their first reset, and what is loaded beside the rest costs no time.
    stages.append(lambda: self._recompute(list(CONSTANTS), places=True))
    # Copies and fills are no kernels, and do happen meanwhile.
    with self._stream(), self._preserved():
      load_kernels(stages, self._wp_device)
    self._run("forward", self._forward)

  # Fields

  def data_field(self, name: str) -> TorchArray:
    if name not in self._data_views:
      array = getattr(self._d, name, None)
      if not isinstance(array, wp.array) or array.shape[0] != self._num_envs:
        raise KeyError(name)
      self._data_views[name] = TorchArray.over(lambda: wp.to_torch(array, requires_grad=False))
    return self._data_views[name]

  def _owner(self, name: str) -> tuple[Any, str]:
    return (self._m.opt, name.removeprefix("opt.")) if name.startswith("opt.") else (self._m, name)

  def model_field(self, name: str) -> TorchArray:
    if name not in self._model_views:
      if name not in PER_WORLD:
        raise KeyError(name)
      owner, attribute = self._owner(name)
      array = getattr(owner, attribute)
      self._model_views[name] = TorchArray.over(lambda: wp.to_torch(array, requires_grad=False))
    return self._model_views[name]

  def expand(self, name: str) -> None:
    self._expanded.add(name)
    owner, attribute = self._owner(name)
    shared = getattr(owner, attribute)
    if shared.shape[0] == self._num_envs:
      return
    with wp.ScopedDevice(self._wp_device):
      rows = wp.zeros((self._num_envs, *shared.shape[1:]), dtype=shared.dtype)
    view = TorchArray.over(lambda: wp.to_torch(rows, requires_grad=False))
    view.copy_(self.model_field(name))
    setattr(owner, attribute, rows)
    self._model_views[name] = view
    self._before.pop(name, None)
    self._graphs.clear()

  # Stages

  def step(self) -> None:
    self._run("step", self._step)

  def forward(self, model_changed: bool) -> None:
    # Every world is recomputed; one that nothing wrote to gets the values it had.
    if model_changed and self._has_moved():
      self._run("forward with places", self._forward_with_places)
    else:
      self._run("forward", self._forward)

  def reset(self, mask: torch.Tensor) -> None:
    self._mask_torch.copy_(mask)
    self._run("reset", self._reset)

  def recompute_constants(self, mask: torch.Tensor | None) -> None:
    version = sum(view._version for name, view in self._model_views.items() if name not in self._expanded)
    is_shared = version != self._shared_version
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
    # Most are derived for all worlds, in single precision: what nobody changed must not change by a rounding.
    for name in fields:
      view = self.model_field(name)
      if name not in self._before:
        self._before[name] = torch.empty_like(view)
      self._before[name].copy_(view)
    others = None if mask is None else ~mask
    places = self._has_moved()
    self._run(f"constants {groups} {places}", lambda: self._recompute(groups, places))
    for name in fields:
      view, before = self.model_field(name), self._before[name]
      if name not in self._expanded and not is_shared:
        view.copy_(before)
      elif name in self._expanded and others is not None:
        where_(view, others, before)
    self._shared_version = sum(v._version for name, v in self._model_views.items() if name not in self._expanded)

  def _has_moved(self) -> bool:
    """Whether somebody may have moved geoms that never move by themselves."""
    return any(name in self._model_views and self._model_views[name]._version for name in _PLACES)

  def count_overflow(self) -> None:
    self._run("overflow", self._count_overflow)

  def _step(self) -> None:
    # Touch is added up, and forces of limits are written where there are any: both count on columns that are zero.
    if self._has_acceleration_sensors:
      wp.launch(
        warp_kernels.clear_acceleration_sensors,
        dim=self._saved_sensors.shape,
        inputs=[self._is_acceleration],
        outputs=[self._d.sensordata],
        device=self._wp_device,
      )
    mjw.step2(self._m, self._d)
    if self._contacts is not None:
      self._contacts.record()
    self._forward()

  def _forward(self) -> None:
    # step1 clears all of sensordata and fills in only what follows from positions and velocities. The rest belongs
    # to the substep just done: it is put aside and written back.
    if self._has_acceleration_sensors:
      wp.launch(
        warp_kernels.save_sensors,
        dim=self._saved_sensors.shape,
        inputs=[self._d.sensordata],
        outputs=[self._saved_sensors],
        device=self._wp_device,
      )
    mjw.step1(self._m, self._d)
    if self._has_acceleration_sensors:
      wp.launch(
        warp_kernels.restore_acceleration_sensors,
        dim=self._saved_sensors.shape,
        inputs=[self._saved_sensors, self._is_acceleration],
        outputs=[self._d.sensordata],
        device=self._wp_device,
      )

  def _reset(self) -> None:
    mjw.reset_data(self._m, self._d, self._mask)
    # MuJoCo C clears these too. They belong to the substep before, and forward does not compute them anew.
    for name in _ACCELERATION_STAGE:
      array = getattr(self._d, name)
      if array.size:
        shape, device = (self._num_envs, array.strides[0] // 4), self._wp_device
        flat = wp.array(ptr=array.ptr, shape=shape, dtype=wp.float32, device=device, copy=False)
        wp.launch(warp_kernels.clear_worlds, dim=shape, inputs=[self._mask], outputs=[flat], device=device)
    if self._contacts is not None:
      self._contacts.forget(self._mask)

  def _recompute(self, groups: list[str], places: bool) -> None:
    if places:
      self._place()
    # What it leaves of kinematics at qpos0 is computed anew by the forward pass that follows.
    bits = sum(int(mjw.SetConstGroup[name]) for name in groups if name != "INERT0")
    mjw.set_const(self._m, self._d, groups=bits, restore=False)
    if "INERT0" in groups:
      self._inverse_weights.compute(self._mask)

  def _forward_with_places(self) -> None:
    self._place()
    self._forward()

  def _place(self) -> None:
    """Put every geom where its body is; MuJoCo Warp leaves those of bodies that never move where they were compiled."""
    m, d = self._m, self._d
    mjw.kinematics(m, d)
    wp.launch(
      smooth._geom_local_to_global,
      dim=(self._num_envs, m.ngeom),
      # No body is welded to the world.
      inputs=[m.body_rootid, self._ones, m.body_mocapid, m.geom_bodyid, m.geom_pos, m.geom_quat, d.xpos, d.xquat],
      outputs=[d.geom_xpos, d.geom_xmat],
      device=self._wp_device,
    )

  def _count_overflow(self) -> None:
    d = self._d
    wp.launch(
      warp_kernels.count_overflow,
      dim=self._num_envs,
      inputs=[d.overflow, d.nefc, d.nacon, d.ncollision],
      outputs=[self._overflow_seen, self._overflow_wanted],
      device=self._wp_device,
    )

  def overflow_report(self) -> list[str]:
    # On a CPU `numpy` is a view of what is cleared below.
    seen, wanted = self._overflow_seen.numpy().copy(), self._overflow_wanted.numpy().copy()
    self._overflow_seen.zero_()
    self._overflow_wanted.zero_()
    report = []
    rows, contacts, pairs = (int(x) for x in wanted)
    average = -(-max(contacts, pairs) // self._num_envs)
    fits = {"njmax": self._d.njmax, "nconmax": self._d.naconmax // self._num_envs}
    want = {"njmax": rows, "nconmax": average}
    for bit, what, setting in _BUFFERS:
      worlds = int((seen & bit.value != 0).sum())
      if not worlds:
        continue
      head = f"{what}: {worlds} of {self._num_envs} worlds"
      if setting in want and want[setting] > fits[setting]:
        per = "" if setting == "njmax" else " on average"
        report.append(
          f"{head} wanted up to {want[setting]} {'rows' if setting == 'njmax' else 'contacts'}{per}, {fits[setting]}"
          f" fit; the rest were dropped. Set --env.sim.{setting} {_round_up(want[setting])}."
        )
      else:
        report.append(f"{head} overflowed. Raise --env.sim.{setting.replace('_', '-')}.")
    for bit, what, setting in _OTHER:
      worlds = int((seen & bit.value != 0).sum())
      if worlds:
        hint = f" Raise --env.sim.{setting}." if setting else ""
        report.append(f"{what}: {worlds} of {self._num_envs} worlds.{hint}")
    return report

  def ray_caster(self, targets: RayTargets, max_distance: float, geomid: bool) -> WarpRayCaster:
    return WarpRayCaster(self, targets, max_distance, geomid=geomid)

  def renderer(self, view: View) -> WarpRenderer:
    return self._stage.renderer(view)

  def contacts(self) -> WarpContacts:
    if self._contacts is None:
      self._contacts = WarpContacts(self._m, self._d, self._num_envs, self._wp_device)
      self._graphs.clear()
    return self._contacts

  def close(self) -> None:
    self._graphs.clear()
    self._fixed_triangles.clear()
    self._surfaces = None
    self._contacts = None
    self._data_views.clear()
    self._model_views.clear()

  # Running

  def _run(self, name: str, stage: Callable[[], None]) -> None:
    """Replay `stage`'s graph, recording it first if need be; inside a larger capture simply record its kernels."""
    if not self._capture:
      with self._stream():
        stage()
      return
    if self._device.type == "cuda":
      if torch.cuda.is_current_stream_capturing():
        stage()
        return
      if name not in self._graphs:
        # Kernels compile and load on their first launch, which a capture does not allow.
        with self._stream(), self._preserved():
          stage()
        self._graphs[name] = capture_cuda(stage, self._device)
    elif name not in self._graphs:
      with wp.ScopedDevice(self._wp_device), wp.ScopedCapture(device=self._wp_device) as capture:
        stage()
      graph: Any = capture.graph
      self._graphs[name] = lambda: wp.capture_launch(graph)
    self._graphs[name]()

  @contextlib.contextmanager
  def _stream(self) -> Generator[None, None, None]:
    """Warp's launches go to torch's current stream, so the two need no synchronisation."""
    with wp.ScopedDevice(self._wp_device):
      if self._device.type == "cuda":
        stream = wp.stream_from_torch(torch.cuda.current_stream(self._device))
        with wp.ScopedStream(stream, sync_enter=False, sync_exit=False):
          yield
      else:
        yield

  @contextlib.contextmanager
  def _preserved(self) -> Generator[None, None, None]:
    """Undo what a warm-up launch does to any array of the data."""
    saved = []
    for owner in (self._d, self._d.contact, self._d.efc):
      for field in dataclasses.fields(owner):
        array = getattr(owner, field.name)
        if isinstance(array, wp.array) and array.size:
          saved.append((array, wp.clone(array)))
    yield
    for array, before in saved:
      wp.copy(array, before)


def check_capture(device: Any) -> None:
  """Refuse a GPU that cannot replay a step as one graph, rather than run it slowly in silence.

  Raises:
    SimulationError: naming what is missing and the switch that runs without graphs.
  """
  if not device.is_cuda:
    return
  missing = []
  if not wp.is_mempool_enabled(device):
    missing.append("Warp's memory pool is disabled on it")
  if not wp.is_conditional_graph_supported():
    missing.append("the driver has no conditional graph nodes (CUDA 12.4 or newer has)")
  if missing:
    raise SimulationError(
      f"{device.name} cannot capture a step: {' and '.join(missing)}. Run without graphs with --env.sim.no-capture."
    )


def capture_cuda(stage: Callable[[], None], device: torch.device) -> Callable[[], None]:
  """`stage` as one CUDA graph, recorded on a stream of its own."""
  recorder = Recorder(device, generators=())
  recorder.record(stage)
  return recorder.replay


def _round_up(count: int) -> int:
  """A little room above what was wanted, to a multiple of eight."""
  return -(-(count + count // 8) // 8) * 8
