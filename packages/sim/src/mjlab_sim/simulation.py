"""Many worlds of one model, stepped together, as PyTorch tensors."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Annotated, Any

import mujoco
import torch
from mjlab_core import Contacts, Limits, MjlabError, PositiveCount, check_fields, check_value

from mjlab_sim.config import SimulationCfg
from mjlab_sim.engine import Closed, Engine
from mjlab_sim.freshness import DataView, Freshness, ModelView
from mjlab_sim.rays import Rays, as_groups, find_targets
from mjlab_sim.rendering import DataType, View, blank_images
from mjlab_sim.sensing import FixedGeometry, RayCaster, Renderer
from mjlab_sim.step_graph import Recordings, StepGraph
from mjlab_sim.world_fields import WorldFields


class Simulation:
  """`num_envs` worlds of one MuJoCo model on one device.

  On a GPU MuJoCo Warp runs them, on a CPU MuJoCo's own batch engine; fields, names, shapes and meaning are the same.

  Nothing read from here is stale. State (`qpos`, `qvel`, `ctrl`, ...) is plain memory that any code may write. All
  else follows from it and is recomputed when it is read after a write: in-place writes are seen through torch's version
  counters, through any view. After `step`, quantities of positions and velocities describe the new state;
  accelerations, forces and contact sensors describe the substep just done.

  Args:
    num_envs: Number of worlds.
    spec: The model; `cfg`'s options are written over its own.
    cfg: Options and buffer sizes.
    device: Where to run, "cpu" or "cuda[:i]".

  Raises:
    MjlabError: an option, model or device that the engine cannot serve.
  """

  def __init__(
    self, num_envs: int, spec: mujoco.MjSpec, cfg: SimulationCfg | None = None, device: str | torch.device = "cpu"
  ) -> None:
    check_value("num_envs", num_envs, PositiveCount)
    self.cfg = SimulationCfg() if cfg is None else cfg
    self.num_envs = num_envs
    self.device = _resolve_device(device)
    self.engine = self.cfg.engine_for(self.device.type)
    self.cfg.validate()
    spec = spec.copy()
    self.cfg.apply(spec)
    self.mj_model: mujoco.MjModel = spec.compile()
    """The compiled model on the host. Never written to."""
    self.timestep: float = self.mj_model.opt.timestep
    """Duration of one physics step [s]."""
    self._engine = _make_engine(self)
    self.dtype = self._engine.dtype
    """Precision of state and derived quantities: float64 on the native engine, float32 on MuJoCo Warp."""
    self._fresh = Freshness(self._engine)
    self.data = DataView(self._fresh)
    self.model = ModelView(self._fresh)
    self._fields = WorldFields(self._fresh, self.mj_model)
    self._recordings = Recordings(self._fresh, self._prepare)
    self._fixed_geometry: FixedGeometry | None = None
    self._keeps_contacts = False

  # Stepping

  def step(self) -> None:
    """Advance every world by one physics step under `data.ctrl`."""
    self._fresh.refresh()
    if not self._recordings.is_inside:
      self._make_room()
    self._engine.step()
    self._fresh.settle()

  def forward(self) -> None:
    """Bring derived quantities up to date with written state now rather than when they are next read."""
    self._fresh.refresh()

  def reset(self, mask: torch.Tensor | None = None) -> None:
    """Set worlds to the model's initial state: qpos0, at rest, no controls, forces or contacts.

    Args:
      mask: Worlds to reset, bool (num_envs,); all by default. The others stay bit-identical.
    """
    if mask is None:
      mask = torch.ones(self.num_envs, dtype=torch.bool, device=self.device)
    self._fresh.check_mask(mask, "reset")
    self._engine.reset(mask)
    self._fresh.note_write()
    self._fresh.version += 1

  @property
  def version(self) -> int:
    """A number that changes whenever derived quantities change; reading it brings them up to date first."""
    self._fresh.refresh()
    return self._fresh.version

  def expire(self) -> None:
    """Have everything that follows from the state computed again when it is next read."""
    self._fresh.refresh()
    self._fresh.version += 1

  @property
  def num_sensed(self) -> int:
    """Number of times that rays were cast or images drawn."""
    return self._fresh.num_sensed

  # Model fields

  def expand_model_fields(self, names: Iterable[str]) -> None:
    """Give model fields one value per world, with every field derived from them.

    Graphs are recorded again. Tensors that were taken before are no longer the simulation's; a write to one raises at
    the next step or read.

    Args:
      names: Fields of MjModel, or `opt.<name>`.

    Raises:
      UnknownNameError: A name that cannot differ per world.
      MjlabError: The call comes from inside a recorded step.
    """
    missing = self._fields.missing(names)
    if missing:
      self._recordings.invalidate_outside(f"model fields {', '.join(missing)} cannot be expanded")
      self._fields.expand(missing)
      if self._fixed_geometry is not None:
        self._fixed_geometry.forget()

  @property
  def expanded_fields(self) -> tuple[str, ...]:
    """Names of the model fields that have one value per world."""
    return tuple(self._fields.expanded)

  def is_expanded(self, name: str) -> bool:
    """Return True if a model field has one value per world."""
    return name in self._fields.expanded

  def default_field(self, name: str) -> torch.Tensor:
    """Return the value that randomisation starts from: the compiled one, (1, ...), as a fresh tensor.

    After `rebase_default_fields` it is that of each world, (num_envs, ...), in fixed memory. Do not write it: a loaded
    state brings the defaults of its worlds into it.
    """
    return self._fields.default(name)

  def rebase_default_fields(self, names: Iterable[str]) -> None:
    """Make the present values of expanded fields the default of each world: for objects that differ between worlds."""
    for name in names:
      self._fields.rebase_default(name)

  def recompute_constants(self, mask: torch.Tensor | None = None) -> None:
    """Recompute derived constants (inverse weights, subtree masses, ...) after a model field changed.

    Args:
      mask: Worlds whose fields changed, bool (num_envs,); all by default.

    Raises:
      MjlabError: MuJoCo cannot derive them for this model; the message says what to change in it.
    """
    if mask is not None:
      self._fresh.check_mask(mask, "recompute_constants")
      # Looking is free on a CPU, and a forward pass of all worlds is not.
      if self.device.type == "cpu" and not mask.numpy().any():
        return
    self._engine.recompute_constants(mask)
    self._fresh.note_write(model=True)

  # State

  def state_dict(self) -> dict[str, dict[str, torch.Tensor]]:
    """Return all that the next step depends on, as fresh tensors: state, model fields and defaults of every world.

    Model fields that all worlds share are in it where they are not as compiled.
    """
    sizes = {name: torch.tensor(size) for name, size in self.buffer_sizes.items()}
    return {**self._fields.state_dict(), "buffers": sizes}

  def load_state_dict(self, state: dict[str, dict[str, torch.Tensor]]) -> None:
    """Continue from a `state_dict` of the same model and number of worlds.

    Raises:
      MjlabError: A field that is missing, unknown or of another shape; nothing was changed.
    """
    state = self._fields.check(state)
    self.keep_buffer_sizes(state)
    self.expand_model_fields(state["model"])
    if self._fields.load(state):
      # Engines derive more than they show; the saved values are then restored to the last bit.
      self.recompute_constants()
      self._fields.load_model(state)

  def keep_buffer_sizes(self, state: dict[str, dict[str, torch.Tensor]]) -> None:
    """Give buffers at least the sizes that they had in a `state_dict`, also of another number of worlds."""
    self._make_room(**{name: int(size) for name, size in state.get("buffers", {}).items()})

  # Contacts, rays, images, overflow

  def contacts(self, world: int) -> Contacts[torch.Tensor]:
    """Return the contacts of one world in the physics step just done, for viewers.

    Steps keep them from the first call on. There are none before the first step after that, nor in a world just reset.
    Bodies have moved on since by one physics step.

    Raises:
      MjlabError: no such world, or a first call from inside a recorded step.
    """
    check_value("world", world, Annotated[int, Limits(ge=0, le=self.num_envs - 1)])
    if not self._keeps_contacts:
      self._recordings.invalidate_outside("contacts cannot be asked for first")
      self._keeps_contacts = True
    return self._engine.contacts(world)

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
    """Return a caster of `num_rays` rays in every world.

    Geoms of zero alpha in the compiled model are not seen.

    Args:
      num_rays: Rays of each world.
      geomgroup: Which of the six geom groups rays see; all by default.
      bodyexclude: A body that rays pass through, or one for each ray, -1 for none.
      exclude_trees: Rays pass through the whole kinematic tree of that body: all of a robot.
      max_distance: How far rays see [m].
      geomid: Identify the geom of each hit. On a CPU terrains of many geoms are faster without.
    """
    targets = find_targets(self.mj_model, num_rays, geomgroup, bodyexclude, exclude_trees, max_distance)
    rays = Rays((self.num_envs, num_rays), self.dtype, self.device, geomid=geomid)
    if self._fixed_geometry is None:
      self._fixed_geometry = FixedGeometry(self.mj_model, self._fresh, self._recordings)
    return RayCaster(self._fresh, self._fixed_geometry, targets, rays)

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
    """Return a renderer of the view of a model's camera in every world, by MuJoCo Warp on either engine.

    Surfaces are seen from outside only, and nothing beyond the far plane, `vis.map.zfar * stat.extent`; there is no
    near plane. Geoms of zero alpha are not seen, and others as if they were opaque.

    Args:
      camera: Number of the camera.
      width: Pixels of a row.
      height: Rows.
      data_types: Kinds of images.
      geomgroup: Which of the six geom groups are seen; all by default.
      textures: Draw textures.
      shadows: Let lights cast shadows.

    Raises:
      MjlabError: an argument that does not fit the model, or a model that MuJoCo Warp cannot draw.
    """
    view = View(
      camera=camera,
      width=width,
      height=height,
      data_types=tuple(data_types),
      geomgroup=as_groups(geomgroup),
      textures=textures,
      shadows=shadows,
    )
    check_fields(view, "renderer")
    check_value("renderer: camera", camera, Annotated[int, Limits(le=self.mj_model.ncam - 1)])
    renderer = Renderer(self._fresh, view, blank_images(view, self.num_envs, self.device))
    self._recordings.invalidate()
    return renderer

  def fixed_geoms_are_in_place(self) -> bool:
    """Return True if geoms that never move are where the compiled model has them.

    It reads the device only after a model field was written. Inside a recording, written fields are not trusted.
    """
    return self._fixed_geometry is None or self._fixed_geometry.is_in_place()

  def overflow_report(self) -> list[str]:
    """Return one line for each buffer that was too small, with the settings that give room. Reads the device.

    A line appears once, and again only when the demand has outgrown its advice: each advice is twice the demand. One
    line for each growth of a buffer has the sizes that a repeat to the last bit needs.
    """
    return self._engine.overflow_report()

  @property
  def buffer_sizes(self) -> dict[str, int]:
    """Room for contacts (`nconmax`) and constraint rows (`njmax`) of each world now; empty on the native engine."""
    return self._engine.buffer_sizes

  def _make_room(self, **at_least: int) -> None:
    if self._engine.make_room(at_least):
      self._recordings.invalidate()
      # Contacts and constraints of the present state are computed again, in the new memory.
      self._fresh.note_write()
      self._fresh.refresh()

  def _prepare(self) -> None:
    self._make_room()
    self.fixed_geoms_are_in_place()

  # Graphs

  def capture(self, fn: Callable[[], object], *, generators: Sequence[torch.Generator] = ()) -> StepGraph:
    """Return `fn` as a step graph, recorded once with torch operations and physics together, then replayed.

    Where nothing can be recorded, on a CPU or with `capture` off, the same code runs eagerly.

    Args:
      fn: Takes no argument and works in fixed memory.
      generators: Random generators that `fn` draws from.
    """
    recorded = self.device.type == "cuda" and self.cfg.capture
    return StepGraph(self._recordings, fn, generators, self.device, recorded=recorded)

  def graph_break(self, fn: Callable[[], object]) -> None:
    """Inside a step graph: call `fn` eagerly at this point of every replay. Elsewhere simply call it.

    Quantities that `fn` reads are up to date, and so is the recording behind it after any write of `fn`.
    """
    self._recordings.interrupt(fn)

  @property
  def is_capturing(self) -> bool:
    """True while a step graph is being recorded: operations are noted, not run."""
    return self._recordings.recorder is not None

  def close(self) -> None:
    """Release threads, graphs and memory. Tensors taken from here must not be used afterwards."""
    self._recordings.invalidate()
    closed: Any = Closed()
    self._engine = closed
    self._fresh.close(closed)


def _resolve_device(device: str | torch.device) -> torch.device:
  resolved = torch.device(device)
  if resolved.type not in ("cpu", "cuda"):
    raise MjlabError(f"device '{device}' is not supported; use 'cpu' or 'cuda'")
  if resolved.type == "cuda":
    if not torch.cuda.is_available():
      raise MjlabError(f"device '{device}' was asked for, but torch finds no GPU; use 'cpu'")
    if resolved.index is None:
      resolved = torch.device("cuda", torch.cuda.current_device())
  return resolved


def _make_engine(sim: Simulation) -> Engine:
  if sim.engine == "native":
    from mjlab_sim.native.engine import NativeEngine

    return NativeEngine(sim.mj_model, sim.num_envs, sim.cfg)
  from mjlab_sim.warp.engine import WarpEngine

  return WarpEngine(sim.mj_model, sim.num_envs, sim.cfg, sim.device)
