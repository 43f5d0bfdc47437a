"""Many copies of a robot with different parameters, stepped together."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
_BODY = ("body_mass", "body_ipos", "body_inertia", "body_iquat")


class _Given:
  """Distribution that returns what it is given, so that the catalogue's own operations write it."""

  def __init__(self, lo: float, hi: float) -> None:
    self.lo, self.hi = lo, hi
    self.values: torch.Tensor | None = None

  def check(self, name: str) -> None:
    del name

  def support(self) -> tuple[float, float]:
    return self.lo, self.hi

  def sample(self, shape: Sequence[int], *, device: Any, dtype: torch.dtype, **_: Any) -> torch.Tensor:
    if self.values is None:
      return torch.full(tuple(shape), 0.5 * (self.lo + self.hi), device=device, dtype=dtype)
    return self.values.to(device, dtype)


@dataclass
class _Bound:
  """A term bound to worlds: its parameters are `columns` of the candidates."""

  columns: slice
  parameters: list[Parameter]
  write: Any
  """Function of the candidates' columns, (num_worlds, len(parameters))."""
  needs_constants: bool


class Worlds:
  """So many worlds of a robot."""

  def __init__(
    self, robot: Robot, num_worlds: int, *, engine: EngineName = "native", device: str = "cpu", threads: int = 0
  ) -> None:
    self.robot, self.num_envs = robot, num_worlds
    self.sim = sim = make_engine(robot, num_worlds, engine, device, threads)
    self.actuators = robot.actuation(num_worlds, sim.data.ctrl)
    self._everyone = torch.ones(num_worlds, dtype=torch.bool, device=sim.device)
    self._bound: list[_Bound] = []
    # Field of the first term that writes a number, by field of MjModel and column; later terms start from its result.
    self._written: dict[tuple[str, int], str] = {}
    driven = self.actuators.target_names
    if others := [name for name in driven if name not in robot.joints]:
      raise MjlabError(f"records are of joints; '{others[0]}' is driven and is none")
    delays = torch.tensor([robot.delays.get(name, 0.0) for name in driven], device=sim.device, dtype=torch.float64)
    self.delay = delays.repeat(num_worlds, 1)
    """Delay of the set-points, (num_worlds, targets) [s]."""
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
      bounds = term.bounds(ranges)
      row = FIELDS[term.field]
      if term.field in ("delay", "encoder_bias"):
        self._bind_own(term, bounds[""])
      elif row.kind == "target":
        self._bind_actuator(term, bounds[""])
      else:
        self._bind_field(term, bounds)
    parameters = [parameter for bound in self._bound for parameter in bound.parameters]
    named = Counter((p.field, p.axis and f".{p.axis}", element) for p in parameters for element in p.elements)
    (field, axis, element), times = named.most_common(1)[0]
    if times > 1:
      raise MjlabError(f"fit: {field}{axis} of '{element}' is named twice")
    return parameters

  def write(self, numbers: np.ndarray) -> None:
    """Write candidates, (num_worlds, parameters)."""
    for bound in self._bound:
      bound.write(np.ascontiguousarray(numbers[:, bound.columns]))
    if any(bound.needs_constants for bound in self._bound):
      self.sim.recompute_constants()

  def overlay(self, numbers: np.ndarray, told: np.ndarray) -> dict[str, Any]:
    """Write one candidate, (parameters,), and return the physical values of told parameters as an overlay holds them.

    Args:
      numbers: The candidate.
      told: True where a parameter is part of the overlay, bool (parameters,).
    """
    self.write(numbers[None].repeat(self.num_envs, 0))
    out: dict[str, Any] = {"model": {}, "actuators": {}, "delay": {}, "encoder_bias": {}}
    parameters = [parameter for bound in self._bound for parameter in bound.parameters]
    for parameter, number, is_told in zip(parameters, numbers.tolist(), told, strict=True):
      for element in parameter.elements if is_told else ():
        if parameter.field in ("delay", "encoder_bias"):
          values = self.delay if parameter.field == "delay" else self.encoder_bias
          out[parameter.field][element] = float(values[0, self.actuators.target_names.index(element)])
        elif FIELDS[parameter.field].kind == "target":
          name: Any = parameter.field
          default = float(ActuatorParameter(self.actuators, self.sim, name, re.escape(element)).default[0, 0])
          scaled = default * number if parameter.operation == "scale" else number
          out["actuators"].setdefault(parameter.field, {})[element] = scaled
        else:
          for name, values in self.physical(parameter.field, element).items():
            out["model"].setdefault(name, {})[element] = values
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

  def _add(self, parameters: list[Parameter], write: Any, constants: bool) -> None:
    begin = self._bound[-1].columns.stop if self._bound else 0
    self._bound.append(_Bound(slice(begin, begin + len(parameters)), parameters, write, constants))

  def _bind_own(self, term: FitTerm, range_: Range) -> None:
    """Delay and encoder offset, which neither MuJoCo nor an actuator model has."""
    every = self.actuators.target_names
    known = self.actuators.driven("joint") if term.field == "delay" else every
    _, names = match_names(term.pattern, known, what="driven joint", owner=f"fit {term.field}")
    columns = [every.index(name) for name in names]
    target = self.delay if term.field == "delay" else self.encoder_bias
    defaults = {name: float(target[0, column]) for name, column in zip(names, columns, strict=True)}

    def write(numbers: np.ndarray) -> None:
      target[:, columns] = torch.from_numpy(numbers).to(target)

    self._add(_parameters(term, "", names, [defaults[name] for name in names], range_), write, False)

  def _bind_actuator(self, term: FitTerm, range_: Range) -> None:
    """Gains and limits, wherever the actuator model keeps them."""
    name: Any = term.field
    parameter = ActuatorParameter(self.actuators, self.sim, name, term.pattern)
    defaults = parameter.default[0].tolist()

    def write(numbers: np.ndarray) -> None:
      factors = torch.from_numpy(np.broadcast_to(numbers, (self.num_envs, len(defaults))).copy()).to(parameter.default)
      parameter.scale(factors if range_[0] == "scale" else factors / parameter.default, self._everyone)

    self._add(_parameters(term, "", list(parameter.names), defaults, range_), write, False)

  def _bind_field(self, term: FitTerm, bounds: Mapping[str, Range]) -> None:
    given = {axis: _Given(lo, hi) for axis, (_, lo, hi) in bounds.items()}
    operation = next(iter(bounds.values()))[0]
    row = FIELDS[term.field]
    by_axis = {row.axes.index(axis): distribution for axis, distribution in given.items()}
    cfg = randomize_field(term.field, term.pattern, by_axis, operation=operation, shared=term.shared)
    bound = RandomizeField(cfg, self.sim, earlier=self._written, owner="fit")
    for key, element in bound.written().items():
      if key in self._written and not cfg.composes:
        raise MjlabError(f"fit: {term.field} of '{element}' is also written by {self._written[key]}; fit one of them")
      self._written.setdefault(key, term.field)
    elements = list(bound.element_names)
    if unnamed := [name for name in elements if name.startswith("(")]:
      raise MjlabError(f"fit {term.field}: {unnamed[0]} has no name, which an overlay needs; name it, or fit others")
    known = {(c.element, c.axis): float(value) for c, value in zip(bound.components, bound.default[0], strict=True)}
    parameters: list[Parameter] = []
    for axis, range_ in bounds.items():
      defaults = [known.get((element, axis), 0.0) for element in elements]
      parameters += _parameters(term, axis, elements, defaults, range_)
    count = 1 if term.shared else len(elements)

    def write(numbers: np.ndarray) -> None:
      for place, distribution in enumerate(given.values()):
        distribution.values = torch.from_numpy(numbers[:, place * count : (place + 1) * count].copy())
      bound.apply(self._everyone, recompute=False)

    self._add(parameters, write, needs_constants(term.field))

  def begin(self, position: np.ndarray, velocity: np.ndarray, orientation: np.ndarray | None = None) -> None:
    """Put the driven joints where encoders read `position`, moving at `velocity`.

    Args:
      position: Readings, (num_worlds, targets). Of a base that moves, six columns more: its position, and a rotation
        vector by which it is turned away from `orientation`, in the world frame.
      velocity: Velocities, (num_worlds, targets). Of a base that moves, six columns more: linear in the world frame,
        and angular in its own.
      orientation: Quaternions of a base that moves, (num_worlds, 4).
    """
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
    """Put joints that follow another one by an equality where it wants them."""
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
    """Advance one timestep under set-points as the encoders read them, (num_worlds, targets) by signal."""
    data, dtype = self.sim.data, self.sim.dtype
    position, velocity = data.qpos[:, self._position], data.qvel[:, self._velocity]
    wanted = [targets[name] - self.encoder_bias if name == TARGETS[0] else targets[name] for name in TARGETS]
    target, target_velocity, effort = (x.to(dtype) for x in wanted)
    with torch.inference_mode():
      self.actuators.compute(target, target_velocity, effort, position, velocity)
    self.sim.step()

  def obey(self, commands: "Commands") -> None:
    """Follow other commands from the next `begin` on."""
    self.commands = commands
    # A recorded step reads the memory of the commands before.
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
  """Set-points of records that worlds follow, each from a row of its own."""

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
    """Return the mean set-points over this timestep, (num_worlds, targets), and move on to the next."""
    begin = self._first + (self.clock * self._timestep - delay) / (self._substeps * self._timestep)
    end = begin + 1.0 / self._substeps
    mean = (self._until(end) - self._until(begin)) * self._substeps
    self.clock += 1.0
    return dict(zip(TARGETS, mean.unbind(-1), strict=True))

  def _until(self, at: torch.Tensor) -> torch.Tensor:
    whole = (at + 1e-9).floor().long().clamp(0, len(self._values) - 1)
    return self._sums[whole, self._columns] + (at - whole).unsqueeze(-1) * self._values[whole, self._columns]


def _parameters(
  term: FitTerm, axis: str, elements: Sequence[str], defaults: Sequence[float], range_: Range
) -> list[Parameter]:
  operation, lo, hi = range_
  groups = [tuple(elements)] if term.shared else [(name,) for name in elements]
  out = []
  for group in groups:
    default = defaults[elements.index(group[0])]
    if operation == "scale" and default == 0.0:
      raise MjlabError(f"fit {term.field}: it is 0 at '{group[0]}', so a factor does nothing; give bounds: =LO..HI")
    neutral = {"scale": 1.0, "add": 0.0, "absolute": default}[operation]
    start = neutral if lo <= neutral <= hi else 0.5 * (lo + hi)
    label = f"{term.field}{axis and '.'}{axis}:{term.pattern if term.shared else group[0]}"
    out.append(
      Parameter(
        name=label,
        field=term.field,
        axis=axis,
        elements=group,
        operation=operation,
        default=default,
        start=start,
        lo=lo,
        hi=hi,
      )
    )
  return out
