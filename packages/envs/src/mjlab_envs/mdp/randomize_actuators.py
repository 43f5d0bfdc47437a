"""Gains, effort limits and delays of actuators as events, alike for every law, in torch or in MuJoCo."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Literal, get_args

import torch
from mjlab_actuators import ActuatorParameter, ActuatorSet, ParameterName, Target, Transmission
from mjlab_core.names import match_names, unknown
from mjlab_core.sampling import check_range
from mjlab_dr import Distribution, as_distribution, check_distribution
from mjlab_managers import EventTermCfg, ManagerTermBase, SceneEntityCfg

from mjlab_envs.mdp.randomize import _writers

if TYPE_CHECKING:
  from mjlab_envs.env import ManagerBasedRlEnv

ActuatorOperation = Literal["scale", "absolute"]
Patterns = str | Sequence[str]
Values = tuple[float, float] | Distribution

_ROBOT = SceneEntityCfg("robot")


class randomize_actuator(ManagerTermBase):
  """Draw gains or effort limits of an entity's actuators in masked worlds, always from what was configured.

  `parameter` is "stiffness", "damping" or "effort_limit". Each target that a pattern matches gets a draw of its own:
  "scale" multiplies what was configured, "absolute" replaces it (both limits of an envelope, in proportion to the
  motoring one). `values` is (lo, hi), uniform, or a distribution of `mjlab_dr`. A limit that the MJCF puts on the joint
  or tendon follows, so that a raised effort limit lets more through.
  """

  def __init__(self, cfg: EventTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    params = cfg.params
    actuators, owner = _actuators(env, params["asset"], f"{self.name} '{params['parameter']}'")
    if params["operation"] not in get_args(ActuatorOperation):
      raise ValueError(unknown("operation", params["operation"], get_args(ActuatorOperation), owner=owner))
    distribution: Distribution = as_distribution(params["values"])
    check_distribution(distribution, owner)
    if distribution.support()[0] < 0.0:
      raise ValueError(f"{owner}: values from {distribution.support()[0]:g} up; none may be negative")
    self.parameter = ActuatorParameter(
      actuators, env.sim, params["parameter"], params["targets"], params["transmission_type"]
    )
    """What is scaled, in the worlds of this environment."""
    _claim(env, params["asset"], params["parameter"], self.parameter.targets, self.parameter.written, owner)
    self._shape = (env.num_envs, len(self.parameter.targets))
    self._strength: torch.Tensor | None = None

  @property
  def strength(self) -> torch.Tensor:
    """How far from what was configured what is written lies, from 0 to 1 for the draw as asked for, ().

    For curricula: written in place it widens the range. Ask for it before the first step is recorded.
    """
    if self._strength is None:
      self._strength = torch.ones((), device=self.parameter.nominal.device, dtype=self.parameter.nominal.dtype)
    return self._strength

  def __call__(
    self,
    env: "ManagerBasedRlEnv",
    mask: torch.Tensor,
    *,
    parameter: ParameterName,
    values: Values,
    operation: ActuatorOperation = "scale",
    targets: Patterns = ".*",
    transmission_type: Transmission = "joint",
    asset: SceneEntityCfg = _ROBOT,
  ) -> None:
    del parameter, targets, transmission_type, asset  # Resolved at build.
    nominal = self.parameter.nominal
    draw = as_distribution(values).sample(self._shape, generator=env.rng, device=nominal.device, dtype=nominal.dtype)
    factor = draw / nominal if operation == "absolute" else draw
    if self._strength is not None:
      factor = torch.lerp(torch.ones_like(factor), factor, self._strength)
    self.parameter.scale(factor, mask)


class randomize_actuator_delay(ManagerTermBase):
  """Draw the lag of delayed actuators in masked worlds, which keep it, through resets too, until it is drawn again.

  `lag_range` is (least, greatest) in physics steps, both included, within what the actuators' configs allow. Targets of
  one law and one delay setting share their delay, so a pattern takes all of them or none.
  """

  def __init__(self, cfg: EventTermCfg, env: "ManagerBasedRlEnv") -> None:
    super().__init__(cfg, env)
    params = cfg.params
    actuators, owner = _actuators(env, params["asset"], self.name)
    transmission: Transmission = params["transmission_type"]
    lo, hi = params["lag_range"]
    check_range(f"{owner}: lag_range", lo, hi, minimum=0)
    if not (isinstance(lo, int) and isinstance(hi, int)):
      raise ValueError(f"{owner}: lag_range is ({lo}, {hi}); lags are whole numbers of physics steps")
    what = f"driven {transmission}"
    _, names = match_names(params["targets"], actuators.driven(transmission), what=what, owner=owner)
    wanted = {Target(transmission, name) for name in names}
    laws = [law for law in actuators.groups if wanted & set(law.group.targets)]
    for law in laws:
      settings, members = law.group.delay, law.group.targets
      if others := [target.name for target in members if target not in wanted]:
        mine = next(target.name for target in members if target in wanted)
        raise ValueError(f"{owner}: '{mine}' shares its delay with {', '.join(others)}; name all of them, or none")
      if not settings.min_lag <= lo <= hi <= settings.max_lag or settings.min_lag == settings.max_lag:
        raise ValueError(
          f"{owner}: lags in [{lo}, {hi}] for '{members[0].name}', whose config has delay_min_lag {settings.min_lag} "
          f"and delay_max_lag {settings.max_lag}; widen those"
        )
    _claim(env, params["asset"], "delay", sorted(wanted), {}, owner)
    self._delays = [law.delay for law in laws if law.delay is not None]
    self.targets = tuple(names)
    """Names of the targets whose delay is drawn."""
    nobody = torch.zeros(env.num_envs, dtype=torch.bool, device=env.device)
    for delay in self._delays:
      delay.pin(nobody, lo)

  def __call__(
    self,
    env: "ManagerBasedRlEnv",
    mask: torch.Tensor,
    *,
    lag_range: tuple[int, int],
    targets: Patterns = ".*",
    transmission_type: Transmission = "joint",
    asset: SceneEntityCfg = _ROBOT,
  ) -> None:
    del targets, transmission_type, asset  # Resolved at build.
    lo, hi = lag_range
    for delay in self._delays:
      delay.pin(mask, torch.randint(lo, hi + 1, (env.num_envs,), generator=env.rng, device=env.device))

  def lags(self) -> torch.Tensor:
    """Lags of the worlds now, (num_envs, number of delays) [physics steps], in new memory."""
    return torch.stack([delay.lag for delay in self._delays], 1)


def _actuators(env: "ManagerBasedRlEnv", asset: SceneEntityCfg, what: str) -> tuple[ActuatorSet, str]:
  entity = env.scene[asset.name]
  if entity.actuators is None:
    raise ValueError(f"entity '{entity.name}': {what}: no actuators are configured for it")
  return entity.actuators, f"entity '{entity.name}': {what}"


def _claim(
  env: "ManagerBasedRlEnv",
  asset: SceneEntityCfg,
  parameter: str,
  targets: Sequence[Target],
  fields: Mapping[tuple[str, int], Target],
  owner: str,
) -> None:
  """Refuses what another event writes already: the two would undo each other's work in silence."""
  written, prefix = _writers.setdefault(env.sim, {}), env.scene[asset.name].prefix
  numbers: dict[tuple[str, int | Target], Target] = {(prefix + parameter, target): target for target in targets}
  for (what, column), target in (numbers | {**fields}).items():
    if (what, column) in written:
      raise ValueError(
        f"{owner}: {what.removeprefix(prefix)} of {target.transmission} '{target.name}' is written by another event "
        f"already, {written[what, column]}; only one of them would count"
      )
    written[what, column] = owner
