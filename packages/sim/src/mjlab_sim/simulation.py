"""Many worlds of one model, stepped together, as PyTorch tensors."""

import math
import operator
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, get_args

import mujoco
import torch
from mjlab_core.counts import why_no_count
from mjlab_core.names import unknown

from mjlab_sim.config import SimulationCfg
from mjlab_sim.contacts import Contacts, EngineContacts
from mjlab_sim.engine import Engine
from mjlab_sim.errors import SimulationError
from mjlab_sim.fields import KINEMATIC_STATE, PER_WORLD, SOURCES, STATE, closure
from mjlab_sim.rays import FreshRayCaster, RayCaster
from mjlab_sim.rendering import DataType, FreshRenderer, Look, Renderer, View
from mjlab_sim.static_rays import FixedGeometry, find_targets
from mjlab_sim.step_graph import StepGraph
from mjlab_sim.torch_array import TorchArray
from mjlab_sim.views import DataView, ModelView

if TYPE_CHECKING:
  from mjlab_sim.graph import Recorder

_version_of = operator.attrgetter("_version")


class Simulation:
  """`num_envs` worlds of one MuJoCo model on one device.

  On a GPU MuJoCo Warp runs them, on a CPU MuJoCo's own batch engine; fields, names, shapes and meaning are the same.

  Nothing read from here is stale. State (`qpos`, `qvel`, `ctrl`, ...) is plain memory that anybody may write. All
  else follows from it, and whoever reads it after a write gets it recomputed first: in-place writes are seen through
  torch's version counters, whatever view they go through. After `step` positions, velocities and what follows from
  them describe the new state; accelerations, forces and contact sensors describe the substep just done.

  Args:
    num_envs: Number of worlds.
    spec: The model; `cfg`'s options are written over its own.
    cfg: Options and buffer sizes.
    device: Where to run, "cpu" or "cuda[:i]".

  Raises:
    SimulationError: an option, model or device that the engine cannot serve.
  """

  def __init__(
    self, num_envs: int, spec: mujoco.MjSpec, cfg: SimulationCfg | None = None, device: str | torch.device = "cpu"
  ) -> None:
    if wrong := why_no_count(num_envs, 1):
      raise SimulationError(f"num_envs {wrong}")
    self.cfg = SimulationCfg() if cfg is None else cfg
    self.num_envs = num_envs
    self.device = _resolve_device(device)
    self.engine = self.cfg.engine_for(self.device.type)
    self.cfg.validate(self.engine)
    spec = spec.copy()
    self.cfg.apply(spec)
    self.mj_model: mujoco.MjModel = spec.compile()
    """The compiled model on the host. Never written to."""
    self.timestep: float = self.mj_model.opt.timestep
    """Duration of one physics step [s]."""
    self._engine = _make_engine(self)
    self.dtype = self._engine.dtype
    """Precision of state and derived quantities: float64 on the native engine, float32 on MuJoCo Warp."""
    self.data = DataView(self)
    self.model = ModelView(self)
    self._kinematic = [_plain(self._engine.data_field(name)) for name in KINEMATIC_STATE]
    self._expanded: dict[str, None] = {}
    self._defaults: dict[str, torch.Tensor] = {}
    # Model fields that somebody asked for, and so may write to.
    self._asked_for: dict[str, TorchArray] = {}
    self._watched: list[torch.Tensor] = []
    # What was handed out of fields before they were expanded, which are somewhere else now; and its version then.
    self._left_behind: list[tuple[str, torch.Tensor, int]] = []
    self._epoch = 0
    self._model_changed = False
    self._state_version = self._versions(self._kinematic)
    self._model_version = 0
    self._recorder: Recorder | None = None
    self._is_replaying = False
    self._graphs: list[StepGraph] = []
    self._closed = False
    self._contacts: EngineContacts | None = None
    self._fixed_geometry: FixedGeometry | None = None
    self._rays_count_on_fixed = True

  # Stepping

  def step(self) -> None:
    """Advance every world by one physics step under `data.ctrl`."""
    self._check_open()
    self._refresh()
    self._engine.step()
    self._settled()

  def forward(self) -> None:
    """Bring derived quantities up to date with written state now rather than when they are next read."""
    self._check_open()
    self._refresh()

  def reset(self, mask: torch.Tensor | None = None) -> None:
    """Set worlds to the model's initial state: qpos0, at rest, no controls, forces or contacts.

    Args:
      mask: Which worlds, bool (num_envs,); all by default. The others stay bit-identical.
    """
    self._check_open()
    if mask is None:
      mask = torch.ones(self.num_envs, dtype=torch.bool, device=self.device)
    self._check_mask(mask, "reset")
    self._engine.reset(mask)
    self._state_version = -1
    self._epoch += 1

  @property
  def epoch(self) -> int:
    """A number that changes whenever derived quantities change; reading it brings them up to date first."""
    self._check_open()
    self._refresh()
    return self._epoch

  # Model fields

  def expand_model_fields(self, names: Iterable[str]) -> None:
    """Give model fields one value per world, with every field derived from them.

    Graphs recorded before hold the old memory and are recorded anew. Tensors taken before are not the simulation's any
    more; who writes to one is told so by the next step or read.

    Args:
      names: Fields of MjModel, or `opt.<name>`.

    Raises:
      SimulationError: a name that cannot differ per world, or a call from inside a recorded step.
    """
    self._check_open()
    field_of = self._engine.model_field
    fresh = [
      name for name in closure(list(names), self.mj_model) if name not in self._expanded and field_of(name).numel() > 0
    ]
    if fresh and (self._recorder is not None or self._is_replaying):
      raise SimulationError(
        f"model fields {', '.join(fresh)} cannot be expanded inside a recorded step; expand them before the first step"
      )
    for name in fresh:
      if name in self._asked_for:
        shared = _plain(self._asked_for[name])
        self._left_behind.append((name, shared, shared._version))
      self._engine.expand(name)
      self._expanded[name] = None
    if fresh:
      self._asked_for = {name: field_of(name) for name in self._asked_for}
      self._watched = [_plain(field) for field in self._asked_for.values()]
      self._watched += [shared for _, shared, _ in self._left_behind]
      # A write to the shared field may not have been seen yet.
      self._model_changed = True
      self._state_version = -1
      self._model_version = self._versions(self._watched)
      if self._fixed_geometry is not None:
        self._fixed_geometry.forget()
      for graph in self._graphs:
        graph.invalidate()

  @property
  def expanded_fields(self) -> tuple[str, ...]:
    """Names of the model fields that have one value per world."""
    return tuple(self._expanded)

  def is_expanded(self, name: str) -> bool:
    """Whether a model field has one value per world."""
    return name in self._expanded

  def default_field(self, name: str) -> torch.Tensor:
    """The value that randomisation starts from: the compiled one, (1, ...), as a fresh tensor.

    Where `rebase_default_fields` said so, it is that of each world, (num_envs, ...), in fixed memory, which is not to
    be written: a loaded state brings the defaults of its worlds into it.
    """
    if name in self._defaults:
      return self._defaults[name]
    view = self.model[name]
    owner = self.mj_model.opt if name.startswith("opt.") else self.mj_model
    value = torch.as_tensor(getattr(owner, name.removeprefix("opt.")), dtype=view.dtype, device=self.device)
    return value.reshape(1, *view.shape[1:]).clone()

  def rebase_default_fields(self, names: Iterable[str]) -> None:
    """Make what these expanded fields are now their default, world by world: for objects that differ between worlds.

    Raises:
      SimulationError: a field that all worlds share.
    """
    for name in names:
      if not self.is_expanded(name):
        raise SimulationError(f"model field '{name}' is shared by all worlds; expand it first")
      now = self.model[name].detach()
      if name in self._defaults:
        self._defaults[name].copy_(now)
      else:
        self._defaults[name] = now.clone()

  def recompute_constants(self, mask: torch.Tensor | None = None) -> None:
    """Recompute what MuJoCo's compiler derives (inverse weights, subtree masses, ...) after a model field changed.

    Args:
      mask: Worlds whose fields changed, bool (num_envs,); all by default.

    Raises:
      SimulationError: MuJoCo cannot derive them for this model; the message says what to change in it.
    """
    self._check_open()
    if mask is not None:
      self._check_mask(mask, "recompute_constants")
      # Looking is free on a CPU, and a forward pass of all worlds is not.
      if self.device.type == "cpu" and not mask.numpy().any():
        return
    self._engine.recompute_constants(mask)
    self._model_changed = True
    self._state_version = -1

  def _model_field(self, name: str) -> TorchArray:
    field = self._asked_for.get(name)
    if field is None:
      self._check_open()
      field = self._asked_for[name] = self._engine.model_field(name)
      self._watched.append(_plain(field))
      # Its memory may have been written to before: what counts is what comes now.
      self._model_version += field._version
    return field

  # State

  def state_dict(self) -> dict[str, dict[str, torch.Tensor]]:
    """All that the next step depends on, as fresh tensors: the state, model fields and defaults of every world.

    Model fields that all worlds share are among it where they are not as compiled.
    """
    self._check_open()
    data = {name: self._engine.data_field(name).detach().clone() for name in STATE}
    shared = closure(self._written_shared(), self.mj_model)
    return {
      "data": {name: field for name, field in data.items() if field.numel()},
      "model": self._model_fields(self._expanded),
      "shared": self._model_fields(name for name in shared if name not in self._expanded),
      "default": {name: field.clone() for name, field in self._defaults.items()},
    }

  def load_state_dict(self, state: dict[str, dict[str, torch.Tensor]]) -> None:
    """Go on from a `state_dict` of the same model and number of worlds.

    Raises:
      SimulationError: a field that is missing, unknown or of another shape; nothing was changed.
    """
    self._check_open()
    for kind in ("data", "model"):
      if kind not in state:
        raise SimulationError(f"saved state lacks '{kind}', it has: {', '.join(state) or 'nothing'}")
    data = {name: field for name in STATE if (field := self._engine.data_field(name)).numel()}
    model = {name: self.model[name] for name in state["model"] if name in PER_WORLD}
    model |= {name: self._engine.model_field(name) for name in self._expanded}
    # States saved before there were defaults of worlds, or shared fields, have none.
    state = {"default": {}, "shared": {}, **state}
    as_compiled = {name: self.default_field(name) for name in self._written_shared() if name not in state["model"]}
    state["shared"] = as_compiled | state["shared"]
    shared = {name: self.model[name] for name in state["shared"] if name in PER_WORLD and name not in self._expanded}
    for kind, fields in (("data", data), ("model", model), ("shared", shared), ("default", self._defaults)):
      for name, value in state[kind].items():
        if name not in fields:
          raise SimulationError(unknown(f"saved {kind} field", name, list(fields)))
        shape = (1 if kind == "shared" else self.num_envs, *fields[name].shape[1:])
        if shape != value.shape:
          raise SimulationError(f"saved {kind} field '{name}' has shape {tuple(value.shape)}, here it is {shape}")
      if absent := [name for name in fields if name not in state[kind]]:
        raise SimulationError(f"saved {kind} fields lack: {', '.join(absent)}")
    self.expand_model_fields(state["model"])
    for name, value in state["data"].items():
      data[name].copy_(value)
    for name, value in state["default"].items():
      self._defaults[name].copy_(value)
    fields = state["shared"] | state["model"]
    self._write_model(fields)
    if not SOURCES.isdisjoint(fields):
      # Engines derive more than they show. What was saved counts to the last bit.
      self.recompute_constants()
      self._write_model(fields)
    self._state_version = -1

  def _written_shared(self) -> list[str]:
    """Fields that all worlds share and that are not as compiled; reads the device."""
    return [
      name
      for name, field in self._asked_for.items()
      if name not in self._expanded and not torch.equal(_plain(field), self.default_field(name))
    ]

  def _model_fields(self, names: Iterable[str]) -> dict[str, torch.Tensor]:
    fields = {name: self._engine.model_field(name).detach().clone() for name in names}
    return {name: field for name, field in fields.items() if field.numel()}

  def _write_model(self, fields: dict[str, torch.Tensor]) -> None:
    for name, value in fields.items():
      self._engine.model_field(name).copy_(value)

  # Contacts, rays, images, overflow

  def contacts(self, world: int) -> Contacts:
    """Contacts of one world in the physics step just done, for whoever looks at it.

    Every step keeps them from the first call on, at a cost of the few worlds asked for: all of up to 64, else those
    asked for last. None are found before the first step after that, nor in a world just reset.

    Raises:
      SimulationError: no such world, or a first call from inside a recorded step.
    """
    self._check_open()
    if not 0 <= world < self.num_envs:
      raise SimulationError(f"world must be from 0 to {self.num_envs - 1}, got {world}")
    if self._contacts is None:
      if self._recorder is not None or self._is_replaying:
        raise SimulationError("contacts are kept from the first call on; call it before the first recorded step")
      self._contacts = self._engine.contacts()
      for graph in self._graphs:
        graph.invalidate()
    return self._contacts.of(world)

  def make_ray_caster(
    self,
    num_rays: int,
    *,
    geomgroup: Sequence[bool] | None = None,
    bodyexclude: int | Sequence[int] = -1,
    exclude_trees: bool = False,
    max_distance: float = math.inf,
    geomid: bool = True,
  ) -> RayCaster:
    """A caster of `num_rays` rays in every world.

    Geoms of zero alpha in the compiled model are not seen.

    Args:
      num_rays: Rays of each world.
      geomgroup: Which of the six geom groups rays see; all by default.
      bodyexclude: A body that rays pass through, or one for each ray, -1 for none.
      exclude_trees: Rays pass through the whole kinematic tree of that body: all of a robot.
      max_distance: How far rays see [m].
      geomid: Whether hits tell their geom. On a CPU terrains of many geoms are faster without.
    """
    self._check_open()
    if not max_distance > 0.0:
      raise SimulationError(f"max_distance must be positive, got {max_distance}")
    targets = find_targets(self.mj_model, num_rays, geomgroup, bodyexclude, exclude_trees)
    if self._fixed_geometry is None:
      self._fixed_geometry = FixedGeometry(self.mj_model, self._engine.model_field)
    return FreshRayCaster(self, self._engine.ray_caster(targets, max_distance, geomid))

  def make_renderer(
    self,
    camera: int,
    width: int,
    height: int,
    data_types: Sequence[DataType] = ("rgb",),
    *,
    geomgroup: Sequence[bool] | None = None,
    textures: bool = True,
    shadows: bool = False,
  ) -> Renderer:
    """A renderer of what a camera of the model sees in every world, by MuJoCo Warp on either engine.

    Surfaces are seen from outside only, and nothing beyond the far plane, `vis.map.zfar * stat.extent`; there is no
    near plane. Geoms of zero alpha are not seen, and others as if they were opaque.

    Args:
      camera: Number of the camera.
      width: Pixels of a row.
      height: Rows.
      data_types: What to draw.
      geomgroup: Which of the six geom groups are seen; all by default.
      textures: Draw textures.
      shadows: Let lights cast shadows.

    Raises:
      SimulationError: an argument that does not fit the model, or a model that MuJoCo Warp cannot draw.
    """
    self._check_open()
    if not 0 <= camera < self.mj_model.ncam:
      raise SimulationError(f"camera must be from 0 to {self.mj_model.ncam - 1}, got {camera}")
    if min(width, height) < 1:
      raise SimulationError(f"an image needs at least one pixel, got width {width} and height {height}")
    for kind in data_types:
      if kind not in get_args(DataType):
        raise SimulationError(unknown("data type", kind, get_args(DataType)))
    if geomgroup is not None and len(geomgroup) != mujoco.mjNGROUP:
      raise SimulationError(f"geomgroup needs {mujoco.mjNGROUP} entries, got {len(geomgroup)}")
    groups = None if geomgroup is None else tuple(bool(group) for group in geomgroup)
    look = Look(geomgroup=groups, textures=textures, shadows=shadows)
    view = View(camera=camera, width=width, height=height, data_types=tuple(data_types), look=look)
    renderer = FreshRenderer(self, self._engine.renderer(view))
    for graph in self._graphs:
      graph.invalidate()
    return renderer

  def fixed_geoms_are_in_place(self) -> bool:
    """Whether geoms that never move are where the compiled model has them; graphs that count on it are dropped.

    Looks at the device only after a model field was written, and never inside a recording, where written fields are not
    trusted.
    """
    geometry = self._fixed_geometry
    if geometry is None:
      return True
    before = self._rays_count_on_fixed
    now = geometry.is_intact(may_look=self._recorder is None)
    if self._recorder is None and now != before:
      self._rays_count_on_fixed = now
      for graph in self._graphs:
        graph.invalidate()
    return now

  def count_overflow(self) -> None:
    """Note contacts and constraints that did not fit. On the device; once an env step is enough."""
    self._check_open()
    self._engine.count_overflow()

  def overflow_report(self) -> list[str]:
    """What did not fit since the last report, one sentence each with the setting to raise. Reads the device."""
    self._check_open()
    return self._engine.overflow_report()

  # Graphs

  def capture(self, fn: Callable[[], object], *, generators: Sequence[torch.Generator] = ()) -> StepGraph:
    """`fn` as a step graph: recorded once with torch operations and physics together, then replayed.

    Where nothing can be recorded, on a CPU or with `capture` off, the same code runs eagerly.

    Args:
      fn: Takes no argument and works in fixed memory.
      generators: Random generators that `fn` draws from.
    """
    graph = StepGraph(self, fn, generators)
    self._graphs.append(graph)
    return graph

  def graph_break(self, fn: Callable[[], object]) -> None:
    """Inside a step graph: call `fn` eagerly at this point of every replay. Elsewhere simply call it.

    What `fn` reads is up to date, and so is what is recorded behind it, whatever state it wrote.
    """
    if self._recorder is None:
      fn()
      return

    def between() -> None:
      # A replay changes memory behind the back of caches.
      self._epoch += 1
      fn()
      self._refresh()

    self._refresh()
    self._recorder.interrupt(between)
    self._epoch += 1

  @property
  def is_capturing(self) -> bool:
    """Whether a step graph is being recorded right now: operations are noted, not run."""
    return self._recorder is not None

  def close(self) -> None:
    """Release threads, graphs and memory. Tensors taken from here must not be used afterwards."""
    if not self._closed:
      self._closed = True
      for graph in self._graphs:
        graph.invalidate()
      self._graphs.clear()
      self._engine.close()

  # Freshness

  @staticmethod
  def _versions(tensors: Iterable[torch.Tensor]) -> int:
    return sum(map(_version_of, tensors))

  def _refresh(self) -> None:
    """Recompute derived quantities if state or a model field was written since."""
    version = self._versions(self._watched)
    if version != self._model_version:
      self._model_version = version
      self._model_changed = True
      self._state_version = -1
      self._check_left_behind()
    if self._versions(self._kinematic) != self._state_version:
      self._engine.forward(self._model_changed)
      self._settled()

  def _check_left_behind(self) -> None:
    written = {name for name, shared, version in self._left_behind if shared._version != version}
    self._left_behind = [(name, shared, shared._version) for name, shared, _ in self._left_behind]
    if written:
      raise SimulationError(
        f"model field {', '.join(sorted(written))} was written through a tensor from before it was expanded, which "
        "changes no world; take it from sim.model again"
      )

  def _settled(self) -> None:
    self._state_version = self._versions(self._kinematic)
    self._model_changed = False
    self._epoch += 1

  def _check_open(self) -> None:
    if self._closed:
      raise SimulationError("this simulation is closed")

  def _check_mask(self, mask: torch.Tensor, what: str) -> None:
    if mask.shape != (self.num_envs,) or mask.dtype != torch.bool:
      raise SimulationError(
        f"{what}: mask must be bool of shape ({self.num_envs},), got {mask.dtype} {tuple(mask.shape)}"
      )


def _plain(field: TorchArray) -> torch.Tensor:
  """The same memory and version counter; a subclass takes twice as long to tell its version."""
  return field.as_subclass(torch.Tensor)


def _resolve_device(device: str | torch.device) -> torch.device:
  resolved = torch.device(device)
  if resolved.type not in ("cpu", "cuda"):
    raise SimulationError(f"device '{device}' is not supported; use 'cpu' or 'cuda'")
  if resolved.type == "cuda":
    if not torch.cuda.is_available():
      raise SimulationError(f"device '{device}' was asked for, but torch finds no GPU; use 'cpu'")
    if resolved.index is None:
      resolved = torch.device("cuda", torch.cuda.current_device())
  return resolved


def _make_engine(sim: Simulation) -> Engine:
  if sim.engine == "native":
    from mjlab_sim.native import NativeEngine

    return NativeEngine(sim.mj_model, sim.num_envs, sim.cfg)
  from mjlab_sim.warp_engine import WarpEngine

  return WarpEngine(sim.mj_model, sim.num_envs, sim.cfg, sim.device)
