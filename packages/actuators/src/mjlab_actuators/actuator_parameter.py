"""Gains, effort limits and delays of chosen targets: in tensors of actuator models, or in fields of MjModel."""

from collections import defaultdict
from collections.abc import Hashable, Iterable, Sequence
from typing import Literal, get_args

import mujoco
import torch
from mjlab_core import MjlabError, ModelFields, check_name, match_names, where_

from mjlab_actuators.actuator import Actuator, CommandField
from mjlab_actuators.actuator_set import ActuatorSet
from mjlab_actuators.models.native import PassThrough
from mjlab_actuators.transmission import Target, Transmission
from mjlab_actuators.xml import servo_target

ParameterName = Literal["stiffness", "damping", "effort_limit"]
"""Parameter of an actuator model."""

# Columns of model fields with the gains of servos and controllers; the first has the number itself.
_GAINS: dict[tuple[CommandField | mujoco.mjtGain, ParameterName], tuple[tuple[str, int], ...]] = {
  ("position_target", "stiffness"): (("actuator_gainprm", 0), ("actuator_biasprm", 1)),
  ("position_target", "damping"): (("actuator_biasprm", 2),),
  ("velocity_target", "damping"): (("actuator_gainprm", 0), ("actuator_biasprm", 2)),
  (mujoco.mjtGain.mjGAIN_DCMOTOR, "stiffness"): (("actuator_gainprm", 4),),
  (mujoco.mjtGain.mjGAIN_DCMOTOR, "damping"): (("actuator_gainprm", 6),),
  (mujoco.mjtGain.mjGAIN_PID, "stiffness"): (("actuator_biasprm", 1),),
  (mujoco.mjtGain.mjGAIN_PID, "damping"): (("actuator_biasprm", 2),),
}
_FORCE_LIMITS = (("actuator_forcerange", 1), ("actuator_forcerange", 0))

_Field = tuple[Actuator | None, str]
"""Parameter of an actuator model, or field of the MuJoCo model."""
_Place = tuple[Actuator | None, str, int]
"""Number of one target: of an actuator model, by parameter and column; or of a model field, by column of its rows."""


class ActuatorParameter:
  """One gain or limit of some targets, with a value per world.

  Scaling always starts from what was configured and compiled, so that repeating it never drifts. For an effort limit,
  the limit that the MJCF puts on all actuators of a joint or tendon together is scaled too; otherwise a raised limit
  would have no effect.

  Construction gives everything involved one row per world; `scale` then runs inside a captured step.
  """

  targets: tuple[Target, ...]
  """Targets in the order of columns."""
  names: tuple[str, ...]
  """Names of the targets."""
  default: torch.Tensor
  """Configured values, (1, num_targets) [the parameter's unit]."""
  claims: dict[tuple[str, Hashable], str]
  """Descriptions of the numbers that are written: by the parameter and its target, and by model field and column of its
  flattened rows."""

  def __init__(
    self,
    actuators: ActuatorSet,
    sim: ModelFields,
    name: ParameterName,
    patterns: str | Sequence[str] = ".*",
    transmission: Transmission = "joint",
  ) -> None:
    """Find the parameter `name` of all targets of one transmission that a pattern matches as a whole.

    Raises:
      UnknownNameError: A pattern matches nothing that is driven.
      MjlabError: A target has no such parameter, or scaling it would change nothing; the message names it.
    """
    check_name("actuator parameter", name, get_args(ParameterName), actuators.owner)
    self.name, self.targets = name, _matched(actuators, patterns, transmission)
    self.names = tuple(target.name for target in self.targets)
    self._sim = sim
    self.claims = _claims(name, self.targets)
    found: dict[_Field, list[tuple[int, int]]] = defaultdict(list)
    nominal: list[float] = []
    for index, target in enumerate(self.targets):
      places = _find(actuators, sim.mj_model, name, target)
      nominal.append(next(value for value in places.values() if value))
      for owner, field, column in places:
        found[owner, field].append((column, index))
        if owner is None:
          self.claims[field, column] = f"{field} of {_described(target)}"
    sim.expand_model_fields([field for owner, field in found if owner is None])
    self._places: dict[_Field, tuple[torch.Tensor, torch.Tensor, torch.Tensor]] = {}
    for (owner, field), pairs in found.items():
      columns, of_target = torch.tensor(pairs, device=sim.device).unbind(1)
      default = sim.default_field(field) if owner is None else owner.nominal(field)
      if owner is not None:
        owner.expand(field)
      self._places[owner, field] = (columns, of_target, default.reshape(1, -1).index_select(1, columns))
    dtype = next(iter(self._places.values()))[2].dtype
    self.default = torch.tensor([nominal], device=sim.device, dtype=dtype)

  def scale(self, factor: torch.Tensor, mask: torch.Tensor) -> None:
    """Write `factor`, (num_envs, num_targets), times what was configured, into worlds of `mask`, bool (num_envs,)."""
    for (owner, field), (columns, of_target, default) in self._places.items():
      values = default * factor.index_select(1, of_target)
      flat = self._flat(owner, field)
      flat.index_copy_(1, columns, where_(flat.index_select(1, columns), mask, values))

  def values(self) -> torch.Tensor:
    """Return the present values of all targets, (num_envs, num_targets), in new memory."""
    factors = self.default.new_ones(self._sim.num_envs, len(self.targets))
    for (owner, field), (columns, of_target, default) in self._places.items():
      # Zeros stay zeros: the factor is seen where its target has another number.
      seen = default[0] != 0.0
      ratio = self._flat(owner, field).index_select(1, columns[seen]) / default[:, seen]
      factors.index_copy_(1, of_target[seen], ratio.to(factors.dtype))
    return factors * self.default

  def write(self, values: torch.Tensor, mask: torch.Tensor) -> None:
    """Write values, (num_envs, num_targets), into the worlds of `mask`, bool (num_envs,)."""
    self.scale(values / self.default, mask)

  def _flat(self, owner: Actuator | None, field: str) -> torch.Tensor:
    # Read at each call, because a later expansion may have replaced the array. A view, never a copy.
    return (getattr(self._sim.model, field) if owner is None else getattr(owner, field)).view(self._sim.num_envs, -1)


class ActuatorDelay:
  """Lags of the delayed actuator models of some targets. Worlds keep a written lag, through resets too.

  Targets of one actuator model and one delay setting share their delay, so patterns name all of them or none.
  """

  names: tuple[str, ...]
  """Names of the targets of each delay, joined by commas."""
  default: torch.Tensor
  """-1 for each delay, whose lag is drawn as configured, (1, num_delays)."""
  claims: dict[tuple[str, Hashable], str]
  """Descriptions of the delays by target."""

  def __init__(
    self,
    actuators: ActuatorSet,
    lag_range: tuple[int, int],
    patterns: str | Sequence[str] = ".*",
    transmission: Transmission = "joint",
  ) -> None:
    """Find the delays of all targets of one transmission that a pattern matches as a whole.

    Raises:
      UnknownNameError: A pattern matches nothing that is driven.
      MjlabError: A target shares its delay with one that is not matched, or cannot have these lags [physics steps].
    """
    targets, (lo, hi), owner = _matched(actuators, patterns, transmission), lag_range, actuators.owner
    driven = [(model, [column.target for column in model.columns]) for model in actuators.groups]
    models = [(model, members) for model, members in driven if not set(targets).isdisjoint(members)]
    for model, members in models:
      least, most = model.delay_min_lag, model.delay_max_lag
      if others := [target.name for target in members if target not in targets]:
        mine = next(target.name for target in members if target in targets)
        raise MjlabError(f"{owner}: '{mine}' shares its delay with {', '.join(others)}; name all of them, or none")
      if not least <= lo <= hi <= most or least == most:
        raise MjlabError(
          f"{owner}: lags in [{lo}, {hi}] for '{members[0].name}', whose config has delay_min_lag {least} "
          f"and delay_max_lag {most}; widen those"
        )
    self._delays = [model.delay for model, _ in models if model.delay is not None]
    self.names = tuple(", ".join(model.target_names) for model, _ in models)
    self.claims = _claims("delay", targets)
    device = self._delays[0].device
    self.default = torch.full((1, len(self._delays)), -1.0, device=device)
    for delay in self._delays:
      # The first write allocates memory, which must not happen in a recorded step.
      delay.pin(torch.zeros(delay.num_envs, dtype=torch.bool, device=device), lo)

  def values(self) -> torch.Tensor:
    """Return the present lags, (num_envs, num_delays) [physics steps], in new memory."""
    return torch.stack([delay.lag for delay in self._delays], 1).to(self.default.dtype)

  def write(self, values: torch.Tensor, mask: torch.Tensor) -> None:
    """Set lags, (num_envs, num_delays) [physics steps], in the worlds of `mask`, bool (num_envs,)."""
    for delay, lag in zip(self._delays, values.long().unbind(1), strict=True):
      delay.pin(mask, lag)


def _matched(actuators: ActuatorSet, patterns: str | Sequence[str], transmission: Transmission) -> tuple[Target, ...]:
  what = f"driven {transmission}"
  _, names = match_names(patterns, actuators.driven(transmission), what=what, owner=actuators.owner)
  return tuple(Target(transmission, name) for name in names)


def _described(target: Target) -> str:
  return f"{target.transmission} '{target.name}'"


def _claims(name: str, targets: Iterable[Target]) -> dict[tuple[str, Hashable], str]:
  return {(name, target): f"{name} of {_described(target)}" for target in targets}


def _find(actuators: ActuatorSet, model: mujoco.MjModel, name: ParameterName, target: Target) -> dict[_Place, float]:
  """Return all places that hold a parameter of one target, with the configured values."""
  owner = f"{actuators.owner}: {name} of {target.transmission} {target.name!r}".removeprefix(": ")
  found: dict[_Place, float] = {}
  element = -1
  for actuator in actuators.groups:
    fields = actuator.effort_limits if name == "effort_limit" else (name,)
    for index, column in enumerate(actuator.columns):
      if column.target == target:
        element, numbers = column.element, column.parameters
        found |= {(actuator, field, index): numbers[field] for field in fields if field in numbers}
        if isinstance(actuator, PassThrough):
          found |= _in_model(model, name, element)
  value = next((number for number in found.values() if number), 0.0)
  if value in (0.0, float("inf")):
    why = "its actuator has none" if not found else "it is zero" if value == 0.0 else "it was not given"
    raise MjlabError(f"{owner}: {why}, so that scaling it changes nothing")
  return found | (_shared_limits(model, target, element, owner) if name == "effort_limit" else {})


def _in_model(model: mujoco.MjModel, name: ParameterName, element: int) -> dict[_Place, float]:
  """Return the places of a parameter of an actuator that MuJoCo computes; none if it has no such parameter."""
  if name == "effort_limit":
    places = _FORCE_LIMITS if model.actuator_forcelimited[element] else ()
  else:
    kind = servo_target(model, element) or mujoco.mjtGain(model.actuator_gaintype[element])
    places = _GAINS.get((kind, name), ())
  tables = [(field, column, getattr(model, field)) for field, column in places]
  return {
    (None, field, element * table.shape[1] + column): abs(float(table[element, column]))
    for field, column, table in tables
  }


def _shared_limits(model: mujoco.MjModel, target: Target, element: int, owner: str) -> dict[_Place, float]:
  """Return the places of the limit on all actuators of a joint or tendon together, if it has one."""
  if target.transmission == "site":
    return {}
  row, prefix = int(model.actuator_trnid[element, 0]), "jnt" if target.transmission == "joint" else "tendon"
  if not getattr(model, f"{prefix}_actfrclimited")[row]:
    return {}
  same = (model.actuator_trntype == model.actuator_trntype[element]) & (model.actuator_trnid[:, 0] == row)
  if same.sum() > 1:
    raise MjlabError(
      f"{owner}: {same.sum()} actuators share its actuatorfrcrange, so that one of them cannot be scaled alone"
    )
  limits = getattr(model, f"{prefix}_actfrcrange")[row].tolist()
  return {(None, f"{prefix}_actfrcrange", 2 * row + side): limit for side, limit in enumerate(limits)}
