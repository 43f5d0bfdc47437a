"""Many copies of a robot with different parameters, stepped together on all cores by MuJoCo's own batch."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import torch
from mjlab_actuators import ActuatorParameter
from mjlab_core.errors import MjlabError
from mjlab_core.names import match_names
from mjlab_dr import FIELDS, RandomizeField, needs_constants, randomize_field
from mujoco.batch import Batch, SimulationError

from mjlab_sysid.parameters import FitTerm, Parameter, Range
from mjlab_sysid.robot import Robot

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

  def sample(self, shape: Sequence[int], **_: Any) -> torch.Tensor:
    if self.values is None:
      return torch.full(tuple(shape), 0.5 * (self.lo + self.hi), dtype=torch.float64)
    return self.values


@dataclass
class _Bound:
  """A term bound to worlds: its parameters are `columns` of the candidates."""

  columns: slice
  parameters: list[Parameter]
  write: Any
  """Function of the candidates' columns, (num_worlds, len(parameters))."""
  needs_constants: bool


class Worlds:
  """So many worlds of a robot; satisfies `mjlab_core.model_fields.ModelFields`."""

  def __init__(self, robot: Robot, num_worlds: int, threads: int = 0) -> None:
    self.robot, self.num_envs, self.device, self.mj_model = robot, num_worlds, torch.device("cpu"), robot.model
    self.batch = Batch(robot.model, num_worlds, threads)
    self.model = SimpleNamespace()
    self.actuators = robot.actuation(num_worlds, torch.from_numpy(self.batch.bind("ctrl")))
    # An output is filled by steps after it is bound.
    self.batch.bind("qfrc_actuator")
    self._everyone = torch.ones(num_worlds, dtype=torch.bool)
    self._bound: list[_Bound] = []
    driven = self.actuators.target_names
    if others := [name for name in driven if name not in robot.joints]:
      raise MjlabError(f"records are of joints; '{others[0]}' is driven and is none")
    self.delay = np.tile([robot.delays.get(name, 0.0) for name in driven], (num_worlds, 1))
    """Delay of the set-points, (num_worlds, targets) [s]."""
    self.encoder_bias = np.zeros((num_worlds, len(driven)))
    """Reading minus truth, (num_worlds, targets) [rad or m]."""
    self._position, self._velocity = robot.addresses(driven)
    self._start = np.zeros((num_worlds, robot.model.nq))
    self._ok = np.ones(num_worlds, dtype=bool)

  def default_field(self, name: str, /) -> torch.Tensor:
    """Return the compiled value, (1, ...)."""
    model = self.robot.model
    value = getattr(model.opt, name[4:]) if name.startswith("opt.") else getattr(model, name)
    return torch.from_numpy(np.array(value)).unsqueeze(0)

  def expand_model_fields(self, names: Iterable[str], /) -> None:
    """Give these fields one value per world."""
    for name in names:
      if not hasattr(self.model, name):
        setattr(self.model, name, torch.from_numpy(self.batch.expand(name)))

  def recompute_constants(self, mask: torch.Tensor | None = None, /) -> None:
    """Recompute what `mj_setConst` derives, for all worlds."""
    del mask
    self.batch.set_const()

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
    seen: set[tuple[str, str, str]] = set()
    for parameter in parameters:
      for element in parameter.elements:
        key = (parameter.field, parameter.axis, element)
        if key in seen:
          raise MjlabError(
            f"fit: {parameter.field}{parameter.axis and '.'}{parameter.axis} of '{element}' is named twice"
          )
        seen.add(key)
    return parameters

  def write(self, numbers: np.ndarray) -> None:
    """Write candidates, (num_worlds, parameters)."""
    for bound in self._bound:
      bound.write(np.ascontiguousarray(numbers[:, bound.columns]))
    if any(bound.needs_constants for bound in self._bound):
      self.batch.set_const()

  def own(self, name: str, joint: str) -> float:
    """Return the delay or the encoder offset of a joint in the first world."""
    values = self.delay if name == "delay" else self.encoder_bias
    return float(values[0, self.actuators.target_names.index(joint)])

  def default_of(self, name: Any, joint: str) -> float:
    """Return the configured gain or limit of a joint."""
    return float(ActuatorParameter(self.actuators, self, name, re.escape(joint)).default[0, 0])

  def physical(self, row: str, element: str) -> dict[str, list[float]]:
    """Return the present values of an element in the fields of MjModel that a row writes, of the first world.

    A body is described whole: its mass, centre, moments and axes.
    """
    kind = FIELDS[row].kind
    fields = _BODY if row in (*_BODY, "pseudo_inertia") else FIELDS[row].fields or (row,)
    accessor = getattr(self.robot.model, kind, None)
    if accessor is None:
      return {name: np.atleast_1d(self.batch.expand(name)[0]).tolist() for name in fields}
    item = accessor(element)
    index = int(
      item.dofadr[0] if fields[0].startswith("dof_") else item.qposadr[0] if fields[0] == "qpos0" else item.id
    )
    return {name: np.atleast_1d(self.batch.expand(name)[0, index]).astype(float).tolist() for name in fields}

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
      target[:, columns] = numbers

    self._add(_parameters(term, "", names, [defaults[name] for name in names], range_), write, False)

  def _bind_actuator(self, term: FitTerm, range_: Range) -> None:
    """Gains and limits, wherever the actuator model keeps them."""
    name: Any = term.field
    parameter = ActuatorParameter(self.actuators, self, name, term.pattern)
    defaults = parameter.default[0].tolist()

    def write(numbers: np.ndarray) -> None:
      factors = torch.from_numpy(np.broadcast_to(numbers, (self.num_envs, len(defaults))).copy())
      parameter.scale(factors if range_[0] == "scale" else factors / parameter.default, self._everyone)

    self._add(_parameters(term, "", list(parameter.names), defaults, range_), write, False)

  def _bind_field(self, term: FitTerm, bounds: Mapping[str, Range]) -> None:
    given = {axis: _Given(lo, hi) for axis, (_, lo, hi) in bounds.items()}
    operation = next(iter(bounds.values()))[0]
    row = FIELDS[term.field]
    by_axis = {row.axes.index(axis): distribution for axis, distribution in given.items()}
    cfg = randomize_field(term.field, term.pattern, by_axis, operation=operation, shared=term.shared)
    bound = RandomizeField(cfg, self, owner="fit")
    elements = list(bound.element_names)
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

  def begin(self, position: np.ndarray, velocity: np.ndarray) -> None:
    """Put the driven joints where encoders read `position`, moving at `velocity`, both (num_worlds, targets)."""
    self.batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
    qpos, qvel = self.batch.bind("qpos"), self.batch.bind("qvel")
    qpos[:] = self.robot.pose
    qpos[:, self._position] = position - self.encoder_bias
    qvel[:] = 0.0
    qvel[:, self._velocity] = velocity
    self._follow_equalities(qpos, qvel)
    self._ok[:] = True

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

  def step(self, targets: Mapping[str, np.ndarray]) -> None:
    """Advance one timestep under set-points as the encoders read them, (num_worlds, targets) by signal."""
    position = self.batch.bind("qpos")[:, self._position]
    velocity = self.batch.bind("qvel")[:, self._velocity]
    commands = {name: targets[name] for name in ("position_target", "velocity_target", "effort_target")}
    commands["position_target"] = commands["position_target"] - self.encoder_bias
    tensors = [torch.from_numpy(np.ascontiguousarray(x)) for x in (*commands.values(), position, velocity)]
    with torch.inference_mode():
      self.actuators.compute(*tensors)
    try:
      self.batch.step(ids=None if self._ok.all() else self._ok)
    except SimulationError as error:
      self._ok[error.ids] = False

  def read(self, name: str) -> np.ndarray:
    """Return a signal, (num_worlds, targets): effort is that of the timestep before; NaN where a world diverged."""
    if name == "position":
      values = self.batch.bind("qpos")[:, self._position] + self.encoder_bias
    else:
      values = self.batch.bind("qvel" if name == "velocity" else "qfrc_actuator")[:, self._velocity].copy()
    values[~self._ok] = np.nan
    return values


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
