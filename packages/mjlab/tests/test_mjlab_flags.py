import enum
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import pytest
from mjlab.cli._config_flags import describe, flags, override
from mjlab.cli._errors import UsageError


class Mode(enum.Enum):
  FAST = 1
  SLOW = 2


@dataclass(kw_only=True)
class TermCfg:
  func: Callable[..., Any]
  weight: float = 1.0
  """Factor of the term."""
  params: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ActuatorCfg:
  stiffness: float | dict[str, float] = 20.0


@dataclass(kw_only=True)
class EnvCfg:
  num_envs: int = 1
  """Number of worlds."""
  dt: float | None = None
  corrupt: bool = True
  name: str = "a"
  cone: Literal["pyramidal", "elliptic"] | None = None
  mode: Mode = Mode.FAST
  range: tuple[float, float] = (0.0, 1.0)
  dims: tuple[int, ...] = (64, 64)
  names: str | Sequence[str] = "foot"
  noise: ActuatorCfg | None = field(default_factory=ActuatorCfg)
  actuators: tuple[ActuatorCfg, ...] = (ActuatorCfg(1.0), ActuatorCfg({".*_hip": 2.0}))
  rewards: dict[str, TermCfg | None] = field(default_factory=dict)
  hook: Callable[[], None] | None = None


SHARED = TermCfg(func=max, weight=-0.1, params={"std": 1, "range": (-1.0, 1), "sensor": "s", "names": ("x", "y")})


def config() -> EnvCfg:
  return EnvCfg(rewards={"foot_slip": SHARED, "other": SHARED})


def put(flag: str, *words: str) -> EnvCfg:
  return override(config(), "env", [(flag, list(words))])


@pytest.mark.parametrize(
  ("flag", "words", "name", "value"),
  [
    ("num-envs", ["10_000"], "num_envs", 10_000),
    ("num_envs", ["1e3"], "num_envs", 1000),
    ("dt", ["0.01"], "dt", 0.01),
    ("dt", ["None"], "dt", None),
    ("corrupt", [], "corrupt", True),
    ("corrupt", ["false"], "corrupt", False),
    ("no-corrupt", [], "corrupt", False),
    ("name", ["None"], "name", "None"),
    ("cone", ["elliptic"], "cone", "elliptic"),
    ("mode", ["SLOW"], "mode", Mode.SLOW),
    ("range", ["-0.5", "2"], "range", (-0.5, 2.0)),
    ("range", ["(-0.5, 2)"], "range", (-0.5, 2.0)),
    ("range", ["-0.5,2"], "range", (-0.5, 2.0)),
    ("dims", ["8"], "dims", (8,)),
    ("dims", ["8", "9", "10"], "dims", (8, 9, 10)),
    ("names", ["toe"], "names", "toe"),
    ("names", ["toe", "heel"], "names", ("toe", "heel")),
    ("noise", ["None"], "noise", None),
  ],
)
def test_a_flag_sets_its_value(flag: str, words: list[str], name: str, value: Any) -> None:
  changed = put(f"env.{flag}", *words)
  assert getattr(changed, name) == value
  assert type(getattr(changed, name)) is type(value)
  before = config()
  setattr(before, name, value)
  assert changed == before


def test_a_term_is_changed_alone_even_where_it_is_shared() -> None:
  changed = put("env.rewards.foot-slip.weight", "-0.2")
  assert changed.rewards["foot_slip"] == TermCfg(func=max, weight=-0.2, params=SHARED.params)
  assert changed.rewards["other"] is SHARED
  assert SHARED.weight == -0.1


@pytest.mark.parametrize(
  ("param", "words", "value"),
  [
    ("std", ["0.5"], 0.5),
    ("range", ["0.5", "2"], (0.5, 2)),
    ("sensor", ["t"], "t"),
    ("names", ["a", "b", "c"], ("a", "b", "c")),
  ],
)
def test_an_untyped_parameter_keeps_its_kind(param: str, words: list[str], value: Any) -> None:
  term = put(f"env.rewards.foot-slip.params.{param}", *words).rewards["foot_slip"]
  assert term is not None
  assert term.params == {**SHARED.params, param: value}


def test_a_term_is_switched_off_with_none() -> None:
  assert put("env.rewards.foot-slip", "None").rewards == {"foot_slip": None, "other": SHARED}


def test_elements_of_tuples_and_patterns_are_flags_too() -> None:
  assert put("env.actuators.0.stiffness", "5").actuators[0] == ActuatorCfg(5.0)
  assert put("env.actuators.1.stiffness..*-hip", "5").actuators[1] == ActuatorCfg({".*_hip": 5.0})


@pytest.mark.parametrize(
  ("flag", "words", "message"),
  [
    ("env.num-envs", ["abc"], "--env.num-envs: expected INT, got abc"),
    ("env.num-envs", ["1.5"], "--env.num-envs: expected INT, got 1.5"),
    ("env.num-envs", [], "--env.num-envs: expected INT, got nothing"),
    ("env.cone", ["round"], "--env.cone: expected pyramidal|elliptic|None, got round"),
    ("env.mode", ["MEDIUM"], "--env.mode: expected FAST|SLOW, got MEDIUM"),
    ("env.range", ["1"], "--env.range: expected FLOAT FLOAT, got 1"),
    ("env.corrupt", ["maybe"], "--env.corrupt: expected true|false, got maybe"),
    (
      "env.rewards.foot-slp.weight",
      ["1"],
      "--env.rewards.foot-slp.weight: no such option. Did you mean --env.rewards.foot-slip.weight?",
    ),
    ("env.weight", ["1"], "--env.weight: no such option. Did you mean --env.rewards.other.weight?"),
    (
      "env.rewards",
      ["1"],
      "--env.rewards: not a single value; its options are --env.rewards.foot-slip, --env.rewards.foot-slip.weight, "
      "--env.rewards.foot-slip.params.std, ...",
    ),
    ("env.rewards.foot-slip", ["1"], "--env.rewards.foot-slip: expected None, got 1"),
  ],
)
def test_a_mistake_says_what_is_possible(flag: str, words: list[str], message: str) -> None:
  with pytest.raises(UsageError) as error:
    put(flag, *words)
  assert str(error.value) == message


def test_help_names_type_default_and_meaning_once_per_group() -> None:
  text = describe(flags(config(), "env"))
  assert "  --env.num-envs INT  (default: 1)\n      Number of worlds." in text
  assert "  --env.rewards.foot-slip.weight FLOAT  (default: -0.1)\n      Factor of the term." in text
  assert "  --env.range FLOAT FLOAT  (default: 0.0 1.0)" in text
  headings = [line for line in text.splitlines() if line.endswith(":") and not line.startswith(" ")]
  assert len(headings) == len(set(headings))
  assert "hook" not in text
