"""Short forms of `randomize` for gains, effort limits and delays of actuators."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

from mjlab_actuators import ParameterName, Transmission
from mjlab_core import Ascending, Limits
from mjlab_dr import Categorical, Distribution, Operation, randomize_field
from mjlab_managers import SceneEntityCfg

from mjlab_envs.mdp.randomize import randomize

if TYPE_CHECKING:
  from mjlab_envs.env import ManagerBasedRlEnv

Patterns = str | Sequence[str]
Values = tuple[float, float] | Distribution

_ROBOT = SceneEntityCfg("robot")


class randomize_actuator(randomize):
  """Draw gains or effort limits of an entity's actuators in masked worlds, always from the configured ones.

  `parameter` is "stiffness", "damping" or "effort_limit". Each target that a pattern matches gets a draw of its own:
  "scale" multiplies the configured value, "absolute" replaces it (both limits of an envelope, in proportion to the
  motoring one), "add" adds to it. `values` is (lo, hi), uniform, or a distribution of `mjlab_dr`. A limit that the MJCF
  puts on the joint or tendon follows, so that a raised effort limit lets more through.
  """

  def __init__(
    self,
    env: "ManagerBasedRlEnv",
    *,
    parameter: ParameterName,
    values: Values,
    operation: Operation = "scale",
    targets: Patterns = ".*",
    transmission_type: Transmission = "joint",
    asset: SceneEntityCfg = _ROBOT,
  ) -> None:
    randomizer = randomize_field(parameter, targets, values, operation=operation)
    super().__init__(env, randomizer=randomizer, asset=asset, transmission_type=transmission_type)


class randomize_actuator_delay(randomize):
  """Draw the lag of delayed actuators in masked worlds, which keep it, through resets too, until it is drawn again.

  `lag_range` is (least, greatest) in physics steps, both included, within what the actuators' configs allow. Targets of
  one actuator model and one delay setting share their delay, so a pattern takes all of them or none.
  """

  def __init__(
    self,
    env: "ManagerBasedRlEnv",
    *,
    lag_range: Annotated[tuple[int, int], Limits(ge=0), Ascending()],
    targets: Patterns = ".*",
    transmission_type: Transmission = "joint",
    asset: SceneEntityCfg = _ROBOT,
  ) -> None:
    lags = range(lag_range[0], lag_range[1] + 1)
    randomizer = randomize_field("delay", targets, Categorical(tuple(lags)))
    super().__init__(env, randomizer=randomizer, asset=asset, transmission_type=transmission_type)
