"""Many copies of a robot with different parameters, stepped together."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
import torch
from mjlab_actuators import ActuatorParameter
from mjlab_core.errors import MjlabError
from mjlab_core.names import match_names
from mjlab_core.rotations import quat_box_plus
from mjlab_dr import FIELDS, RandomizeField, needs_constants, randomize_field

from mjlab_sysid.engines import EngineName, make_engine
from mjlab_sysid.parameters import FitTerm, Parameter, Range
from mjlab_sysid.robot import Robot

TARGETS = ("position_target", "velocity_target", "effort_target")
"""Signals that command joints."""
_OWN = ("delay", "encoder_bias")
_Term = tuple[list[Parameter], Callable[[torch.Tensor], None]]
"""Parameters of a term, and the function that writes their numbers, (num_worlds, parameters)."""
_BODY = ("body_mass", "body_ipos", "body_inertia", "body_iquat")


class _Given:
  """Distribution that returns given values, which the operations of the catalogue write."""

  def __init__(self, lo: float, hi: float) -> None:
    self.lo, self.hi = lo, hi
    self.values = torch.empty(0)

  def check(self, name: str) -> None:
    del name

  def support(self) -> tuple[float, float]:
    return self.lo, self.hi

  def sample(self, shape: Sequence[int], *, device: Any, dtype: torch.dtype, **_: Any) -> torch.Tensor:
    del shape
    return self.values.to(device, dtype)


class Worlds:
  """Worlds of a robot with different parameters."""

  def __init__(
    self, robot: Robot, num_worlds: int, *, engine: EngineName = "native", device: str = "cpu", threads: int = 0
  ) -> None:
    self.robot, self.num_envs = robot, num_worlds
    self.sim = sim = make_engine(robot, num_worlds, engine, device, threads)
    self.actuators = robot.actuation(sim.data.ctrl)
    self._everyone = torch.ones(num_worlds, dtype=torch.bool, device=sim.device)
    self._terms: list[_Term] = []
    # Field of the first term that writes a number, by its key; later terms start from its result.
    self._written: dict[Any, str] = {}
    driven = self.actuators.target_names
    if others := [name for name in driven if name not in robot.joints]:
      raise MjlabError(f"records are of joints; '{others[0]}' is driven and is not a joint")
    delays = torch.tensor([robot.delays.get(name, 0.0) for name in driven], device=sim.device, dtype=torch.float64)
    self.delay = delays.repeat(num_worlds, 1)
    """Delay of the targets, (num_worlds, targets) [s]."""
    self.encoder_bias = torch.zeros_like(self.delay)
    """Reading minus truth, (num_worlds, targets) [rad or m]."""
    position, velocity = robot.addresses(driven)
    self._position, self._velocity = (torch.from_numpy(x).long().to(sim.device) for x in (position, velocity))
    self.commands: Commands | None = None
    """Commands that are followed."""
    self._tick = sim.capture(self._follow)

  def bind(self, terms: Sequence[FitTerm], ranges: Mapping[str, Range]) -> list[Parameter]:
    """Find the parameters that terms describe; `write` then takes one column for each.

    Raises:
      UnknownNameError: A pattern matches nothing.
      MjlabError: A parameter cannot have an effect, may become unphysical, or is named twice.
    """
    for term in terms:
      bind = self._bind_own if term.field in _OWN else self._bind_field
      self._terms.append(bind(term, term.bounds(ranges)))
    parameters = self.parameters
    named = Counter((p.field, p.axis and f".{p.axis}", element) for p in parameters for element in p.elements)
    (field, axis, element), times = named.most_common(1)[0]
    if times > 1:
      raise MjlabError(f"fit: {field}{axis} of '{element}' is named twice")
    return parameters

  @property
  def parameters(self) -> list[Parameter]:
    """Parameters in the order of the columns of `write`."""
    return [parameter for parameters, _ in self._terms for parameter in parameters]

  def write(self, numbers: np.ndarray) -> None:
    """Write candidates, (num_worlds, parameters)."""
    begin = 0
    for parameters, write in self._terms:
      end = begin + len(parameters)
      write(torch.from_numpy(numbers[:, begin:end].copy()))
      begin = end
    if any(needs_constants(parameter.field) for parameter in self.parameters):
      self.sim.recompute_constants()

  def overlay(self, numbers: np.ndarray, identifiable: np.ndarray) -> dict[str, Any]:
    """Write one candidate, and return the physical values of identifiable parameters as an overlay holds them.

    Args:
      numbers: The candidate, (parameters,).
      identifiable: True where a parameter is part of the overlay, bool (parameters,).
    """
    self.write(numbers[None].repeat(self.num_envs, 0))
    out: dict[str, Any] = {"model": {}, "actuators": {}, "delay": {}, "encoder_bias": {}}
    for parameter, number, is_kept in zip(self.parameters, numbers.tolist(), identifiable, strict=True):
      field = parameter.field
      for place, element in enumerate(parameter.elements) if is_kept else ():
        if FIELDS[field].in_model:
          for name, values in self.physical(field, element).items():
            out["model"].setdefault(name, {})[element] = values
        else:
          section = out if field in _OWN else out["actuators"]
          section.setdefault(field, {})[element] = parameter.value(number, place)
    return out

  def physical(self, row: str, element: str) -> dict[str, list[float]]:
    """Return the present values of an element in the fields of MjModel that a row writes, of the first world.

    A body is described whole: its mass, centre, moments and axes.
    """
    field = FIELDS[row]
    names = (row, field.moves_with) if field.moves_with else (row,)
    fields = _BODY if row in (*_BODY, "pseudo_inertia") else field.fields or names
    # Fields that nothing has written are shared by all worlds.
    values = {name: getattr(self.sim.model, name, self.sim.default_field(name))[0].cpu().numpy() for name in fields}
    if field.kind == "option":
      return {name: np.atleast_1d(value).astype(float).tolist() for name, value in values.items()}
    item = getattr(self.robot.model, field.kind)(element)
    index = int(item.dofadr[0] if field.at == "dof" else item.qposadr[0] if field.at == "qpos" else item.id)
    return {name: np.atleast_1d(value[index]).astype(float).tolist() for name, value in values.items()}

  def _bind_own(self, term: FitTerm, bounds: Mapping[str, Range]) -> _Term:
    """Bind a delay or an encoder offset, which neither MuJoCo nor an actuator model has."""
    every, target = self.actuators.target_names, getattr(self, term.field)
    known = self.actuators.driven("joint") if term.field == "delay" else every
    _, names = match_names(term.pattern, known, what="driven joint", owner=f"fit {term.field}")
    columns = [every.index(name) for name in names]

    def write(numbers: torch.Tensor) -> None:
      target[:, columns] = numbers.to(target)

    return _parameters(term, "", dict(zip(names, target[0, columns].tolist(), strict=True)), bounds[""]), write

  def _bind_field(self, term: FitTerm, bounds: Mapping[str, Range]) -> _Term:
    """Bind a row of MjModel, or a gain or limit of actuator models."""
    name: Any = term.field
    is_gain = not FIELDS[name].in_model
    target = ActuatorParameter(self.actuators, self.sim, name, term.pattern) if is_gain else None
    given = {axis: _Given(lo, hi) for axis, (_, lo, hi) in bounds.items()}
    operation = next(iter(bounds.values()))[0]
    cfg = randomize_field(name, term.pattern, given, operation=operation, shared=term.shared)
    bound = RandomizeField(cfg, self.sim, target=target, earlier=self._written, owner="fit")
    for key, description in bound.claims.items():
      if key in self._written and not cfg.composes:
        raise MjlabError(f"fit: {description} is also written by {self._written[key]}; fit one of them")
      self._written.setdefault(key, name)
    elements = bound.element_names
    if unnamed := [element for element in elements if element.startswith("(")]:
      raise MjlabError(f"fit {name}: {unnamed[0]} has no name, which an overlay needs; name it, or fit others")
    known = {(c.element, c.axis): value for c, value in zip(bound.components, bound.default[0].tolist(), strict=True)}
    parameters: list[Parameter] = []
    for axis, range_ in bounds.items():
      defaults = {element: known.get((element, axis), 0.0) for element in elements}
      parameters += _parameters(term, axis, defaults, range_)

    def write(numbers: torch.Tensor) -> None:
      for distribution, values in zip(given.values(), numbers.chunk(len(given), 1), strict=True):
        distribution.values = values
      bound.apply(self._everyone, recompute=False)

    return parameters, write

  def begin(self, state: np.ndarray, orientation: np.ndarray | None = None) -> None:
    """Set the state of the driven joints, and of a base that moves.

    Args:
      state: Positions as encoders read them, and velocities, (num_worlds, 2, targets). A base that moves has six more
        columns: its position, and a rotation vector from `orientation`, in the world frame; its linear velocity in the
        world frame, and its angular velocity in the frame of the base.
      orientation: Quaternions of a base that moves, (num_worlds, 4).
    """
    position, velocity = state[:, 0], state[:, 1]
    count = len(self.actuators.target_names)
    addresses, dofs = self._position.cpu().numpy(), self._velocity.cpu().numpy()
    qpos = np.tile(self.robot.pose, (self.num_envs, 1))
    qvel = np.zeros((self.num_envs, self.robot.model.nv))
    qpos[:, addresses] = position[:, :count] - self.encoder_bias.cpu().numpy()
    qvel[:, dofs] = velocity[:, :count]
    if self.robot.base is not None and orientation is not None:
      free = self.robot.model.joint(self.robot.base)
      qpos[:, free.qposadr[0] + np.arange(3)] = position[:, count : count + 3]
      turned = quat_box_plus(torch.from_numpy(orientation), torch.from_numpy(position[:, count + 3 :].copy()))
      qpos[:, free.qposadr[0] + np.arange(3, 7)] = turned.numpy()
      qvel[:, free.dofadr[0] + np.arange(6)] = velocity[:, count:]
    self._follow_equalities(qpos, qvel)
    self.sim.reset()
    self.sim.data.qpos[:] = torch.from_numpy(qpos).to(self.sim.data.qpos)
    self.sim.data.qvel[:] = torch.from_numpy(qvel).to(self.sim.data.qvel)
    if self.commands is not None:
      self.commands.clock.zero_()

  def _follow_equalities(self, qpos: np.ndarray, qvel: np.ndarray) -> None:
    """Set the joints that follow another one by an equality."""
    model = self.robot.model
    for index in np.flatnonzero(model.eq_type == mujoco.mjtEq.mjEQ_JOINT):
      one, other = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
      if other < 0 or not model.eq_active0[index]:
        continue
      polynomial = np.polynomial.Polynomial(model.eq_data[index, :5])
      first, second = model.jnt_qposadr[[one, other]]
      away = qpos[:, second] - model.qpos0[second]
      qpos[:, first] = model.qpos0[first] + polynomial(away)
      qvel[:, model.jnt_dofadr[one]] = polynomial.deriv()(away) * qvel[:, model.jnt_dofadr[other]]

  def step(self, targets: Mapping[str, torch.Tensor]) -> None:
    """Advance one timestep under targets as the encoders read them, (num_worlds, targets) by signal."""
    data, dtype = self.sim.data, self.sim.dtype
    position, velocity = data.qpos[:, self._position], data.qvel[:, self._velocity]
    wanted = [targets[name] - self.encoder_bias if name == TARGETS[0] else targets[name] for name in TARGETS]
    target, target_velocity, effort = (x.to(dtype) for x in wanted)
    with torch.inference_mode():
      self.actuators.compute(target, target_velocity, effort, position, velocity)
    self.sim.step()

  def obey(self, commands: "Commands") -> None:
    """Follow these commands from the next `begin` on."""
    self.commands = commands
    # A recorded step reads the memory of the previous commands.
    self._tick = self.sim.capture(self._follow)

  def follow(self) -> None:
    """Advance one timestep under `commands`, each delayed by `delay`."""
    self._tick()

  def _follow(self) -> None:
    assert self.commands is not None
    self.step(self.commands.now(self.delay))

  def is_late(self, name: str) -> bool:
    """Return True if a signal, once read, describes the beginning of the last timestep instead of its end."""
    # MuJoCo computes sensors before it integrates; `Simulation` brings those of velocities up to date.
    return name in ("effort", "linear_acceleration") or (name == "angular_velocity" and self.sim.engine == "native")

  def read(self, name: str) -> torch.Tensor:
    """Return a signal, (num_worlds, targets, 3 or 4); NaN where a world diverged."""
    data, model = self.sim.data, self.robot.model
    if name == "position":
      values = data.qpos[:, self._position] + self.encoder_bias
    elif name in ("velocity", "effort"):
      values = (data.qvel if name == "velocity" else data.qfrc_actuator)[:, self._velocity]
    elif name in ("base_position", "base_orientation"):
      begin = model.joint(self.robot.base).qposadr[0] + (3 if name == "base_orientation" else 0)
      values = data.qpos[:, begin : begin + (4 if name == "base_orientation" else 3)]
    else:
      begin = model.sensor(f"sysid/{name}").adr[0]
      values = data.sensordata[:, begin : begin + 3]
    return torch.where(torch.isfinite(data.qpos).all(1, keepdim=True), values.double(), torch.nan)


class Commands:
  """Targets of records that worlds follow, each from its own row."""

  def __init__(
    self,
    source: object,
    values: Mapping[str, np.ndarray],
    first: np.ndarray,
    timestep: float,
    substeps: int,
    device: torch.device,
  ) -> None:
    self.source = source
    """Object that the commands belong to."""
    stacked = np.stack([values[name] for name in TARGETS], -1)
    # Times need more digits than a GPU's physics.
    self._values = torch.from_numpy(stacked).to(device, torch.float64)
    self._sums = torch.nn.functional.pad(self._values.cumsum(0), (0, 0, 0, 0, 1, 0))
    self._first = torch.from_numpy(first).to(device, torch.float64)[:, None]
    self._columns = torch.arange(stacked.shape[1], device=device)
    self._timestep, self._substeps = timestep, substeps
    self.clock = torch.zeros((), device=device, dtype=torch.float64)
    """Timesteps since the beginning."""

  def now(self, delay: torch.Tensor) -> dict[str, torch.Tensor]:
    """Return the mean targets over this timestep, (num_worlds, targets), and move on to the next."""
    begin = self._first + (self.clock * self._timestep - delay) / (self._substeps * self._timestep)
    end = begin + 1.0 / self._substeps
    mean = (self._until(end) - self._until(begin)) * self._substeps
    self.clock += 1.0
    return dict(zip(TARGETS, mean.unbind(-1), strict=True))

  def _until(self, at: torch.Tensor) -> torch.Tensor:
    whole = (at + 1e-9).floor().long().clamp(0, len(self._values) - 1)
    return self._sums[whole, self._columns] + (at - whole).unsqueeze(-1) * self._values[whole, self._columns]


def _parameters(term: FitTerm, axis: str, defaults: Mapping[str, float], range_: Range) -> list[Parameter]:
  operation, lo, hi = range_
  out = []
  for group in [tuple(defaults)] if term.shared else [(name,) for name in defaults]:
    default = defaults[group[0]]
    if operation == "scale" and default == 0.0:
      raise MjlabError(f"fit {term.field}: it is 0 at '{group[0]}', so a factor does nothing; give bounds: =LO..HI")
    neutral = {"scale": 1.0, "add": 0.0, "absolute": default}[operation]
    out.append(
      Parameter(
        name=f"{term.field}{axis and '.'}{axis}:{term.pattern if term.shared else group[0]}",
        field=term.field,
        axis=axis,
        elements=group,
        operation=operation,
        defaults=tuple(defaults[element] for element in group),
        start=neutral if lo <= neutral <= hi else 0.5 * (lo + hi),
        lo=lo,
        hi=hi,
      )
    )
  return out
