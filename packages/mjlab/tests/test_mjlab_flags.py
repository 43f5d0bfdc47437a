import enum
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import pytest
from mjlab.cli.shared._flags import flags, help_rows, parse, print_completion
from mjlab.cli.shared._task_help import task_help
from mjlab_core import UsageError

# A configuration may hold a list where its annotation says tuple.
A_LIST: Any = ["a"]


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
  shade: float | tuple[float, float] = 0.5
  limit: float | None = 2.0
  groups: tuple[str, ...] = field(default_factory=lambda: A_LIST)
  hole: float = math.nan
  dims: tuple[int, ...] = (64, 64)
  names: str | Sequence[str] = "foot"
  ids: str | int | tuple[str, ...] | tuple[int, ...] | None = None
  noise: ActuatorCfg | None = field(default_factory=ActuatorCfg)
  actuators: tuple[ActuatorCfg, ...] = (ActuatorCfg(1.0), ActuatorCfg({".*_hip": 2.0}))
  rewards: dict[str, TermCfg | None] = field(default_factory=dict)
  hook: Callable[[], None] | None = None


@dataclass(kw_only=True)
class Line:
  """Flags of `train` and a configuration."""

  seed: int | None = None
  env: EnvCfg


SHARED = TermCfg(func=max, weight=-0.1, params={"std": 1, "range": (-1.0, 1), "sensor": "s", "names": ("x", "y")})


def config() -> EnvCfg:
  return EnvCfg(rewards={"foot_slip": SHARED, "other": SHARED})


def put(*words: str) -> EnvCfg:
  return parse(Line(env=config()), words).env


@pytest.mark.parametrize(
  ("flag", "name", "value"),
  [
    ("--env.num-envs 10_000", "num_envs", 10_000),
    ("--env.num_envs 3", "num_envs", 3),
    ("--env.num-envs=3", "num_envs", 3),
    ("--env.num-envs 2 --env.num-envs 3", "num_envs", 3),
    ("--env.dt 0.01", "dt", 0.01),
    ("--env.dt -1e-3", "dt", -0.001),
    ("--env.dt None", "dt", None),
    ("--env.limit None", "limit", None),
    ("--env.limit -inf", "limit", -math.inf),
    ("--env.no-corrupt", "corrupt", False),
    ("--env.corrupt", "corrupt", True),
    ("--env.name None", "name", "None"),
    ("--env.name=--x", "name", "--x"),
    ("--env.cone elliptic", "cone", "elliptic"),
    ("--env.cone None", "cone", None),
    ("--env.mode SLOW", "mode", Mode.SLOW),
    ("--env.range -0.5 2", "range", (-0.5, 2.0)),
    ("--env.shade 1", "shade", 1.0),
    ("--env.shade 1 2", "shade", (1.0, 2.0)),
    ("--env.dims 8", "dims", (8,)),
    ("--env.dims 8 9 10", "dims", (8, 9, 10)),
    ("--env.dims", "dims", ()),
    ("--env.names toe", "names", "toe"),
    ("--env.names toe heel", "names", ("toe", "heel")),
    ("--env.groups b c", "groups", ["b", "c"]),
    ("--env.ids 3", "ids", 3),
    ("--env.ids 3 4", "ids", (3, 4)),
    ("--env.ids toe", "ids", "toe"),
    ("--env.noise None", "noise", None),
    ("--env.noise.stiffness 3 --env.noise None", "noise", None),
    ("--env.noise on", "noise", ActuatorCfg()),
  ],
)
def test_a_flag_sets_its_value_and_no_other(flag: str, name: str, value: Any) -> None:
  changed = put(*flag.split())
  assert getattr(changed, name) == value
  assert type(getattr(changed, name)) is type(value)
  expected = config()
  setattr(expected, name, value)
  assert vars(changed) == vars(expected)


def test_no_flags_give_the_same_objects_back() -> None:
  line = Line(env=config())
  assert parse(line, []) is line
  assert parse(line, ["--seed", "1"]).env is line.env


def test_present_values_may_be_given() -> None:
  assert vars(put("--env.num-envs", "1", "--env.range", "0", "1", "--env.name", "a")) == vars(config())


def test_a_shared_term_is_changed_in_one_place() -> None:
  changed = put("--env.rewards.foot-slip.weight", "-0.2")
  assert changed.rewards["foot_slip"] == TermCfg(func=max, weight=-0.2, params=SHARED.params)
  assert changed.rewards["other"] is SHARED
  assert SHARED.weight == -0.1


@pytest.mark.parametrize(
  ("param", "words", "value"),
  [
    ("std", ["0.5"], 0.5),
    ("std", ["2"], 2),
    ("range", ["0.5", "2"], (0.5, 2)),
    ("sensor", ["t"], "t"),
    ("names", ["a", "b", "c"], ("a", "b", "c")),
  ],
)
def test_an_untyped_parameter_keeps_its_kind(param: str, words: list[str], value: Any) -> None:
  term = put(f"--env.rewards.foot-slip.params.{param}", *words).rewards["foot_slip"]
  assert term is not None
  assert term.params == {**SHARED.params, param: value}
  assert type(term.params[param]) is type(value)


def test_none_removes_a_term() -> None:
  assert put("--env.rewards.foot-slip", "None").rewards == {"foot_slip": None, "other": SHARED}


def test_elements_of_tuples_and_patterns_are_flags_too() -> None:
  assert put("--env.actuators.0.stiffness", "5").actuators[0] == ActuatorCfg(5.0)
  assert put("--env.actuators.1.stiffness.*-hip", "5").actuators[1] == ActuatorCfg({".*_hip": 5.0})
  assert put("--env.actuators.1.stiffness.*_hip", "5").actuators[1] == ActuatorCfg({".*_hip": 5.0})


def test_keys_that_differ_in_hyphens_alone_are_one_flag() -> None:
  stiffness: dict[str, float] = {"a_b": 1.0, "a-b": 2.0}
  assert parse(ActuatorCfg(stiffness), ["--stiffness.a_b", "3"]).stiffness == {"a_b": 1.0, "a-b": 3.0}
  assert [row.name for row in help_rows(ActuatorCfg(stiffness))] == ["stiffness.a-b"]


@pytest.mark.parametrize(
  ("given", "message"),
  [
    ("--env.num-envs abc", "--env.num-envs: expected INT, got abc"),
    ("--env.num-envs 1.5", "--env.num-envs: expected INT, got 1.5"),
    ("--env.num-envs", "--env.num-envs: expected INT, got nothing"),
    ("--env.num-envs=", "--env.num-envs: expected INT, got nothing"),
    ("--env.num-envs 1 2", "--env.num-envs: expected INT, got 1 2"),
    ("--env.num-envs 1 --env.dt x", "--env.dt: expected {None}|FLOAT, got x"),
    ("--env.cone round", "--env.cone: expected {None,pyramidal,elliptic}, got round"),
    ("--env.mode MEDIUM", "--env.mode: expected {FAST,SLOW}, got MEDIUM"),
    ("--env.range 1", "--env.range: expected FLOAT FLOAT, got 1"),
    ("--env.range 1 x", "--env.range: expected FLOAT FLOAT, got 1 x"),
    ("--env.corrupt false", "--env.corrupt: expected no value (--env.no-corrupt switches it off), got false"),
    ("--env.corrupt=false", "--env.corrupt: expected no value (--env.no-corrupt switches it off), got false"),
    ("--env.rewards.foot-slip 1", "--env.rewards.foot-slip: expected {on,None}, got 1"),
    ("--env.num-envs --env.dt 1", "--env.num-envs: expected INT, got nothing"),
    ("4 --env.dt 1", "'4': not a flag"),
    (
      "--env.rewards.foot-slp.weight 1",
      "--env.rewards.foot-slp.weight: no such option. Did you mean --env.rewards.foot-slip.weight?",
    ),
    ("--env.weight=1", "--env.weight: no such option. Did you mean --env.rewards.other.weight?"),
    ("--env.no-dt", "--env.no-dt: no such option. Did you mean --env.dt?"),
    (
      "--env.rewards 1",
      "--env.rewards: not a single value; its options are --env.rewards.foot-slip, --env.rewards.foot-slip.weight, "
      "--env.rewards.foot-slip.params.std, ...",
    ),
  ],
)
def test_a_mistake_names_what_is_allowed(given: str, message: str, capfd: pytest.CaptureFixture[str]) -> None:
  with pytest.raises(UsageError) as error:
    put(*given.split())
  assert str(error.value) == message
  assert capfd.readouterr() == ("", "")


def test_values_without_a_text_form_have_no_flag() -> None:
  names = {flag.name for flag in flags(Line(env=config()))}
  assert not {"env.hook", "env.rewards.foot-slip.func"} & names


def help_of(word: str) -> str:
  return task_help("train", "Task", (), word, lambda: Line(env=config()))


def test_help_names_choices_default_and_meaning() -> None:
  text = help_of("")
  assert text.startswith("usage: train Task [flags]\n")
  for line in (
    r"  --seed {None}|INT \[None\] +",
    r"  --env.num-envs INT \[1\] +Number of worlds\.",
    r"  --env.corrupt | --env.no-corrupt \[o(n|ff)\]",
    r"  --env.range FLOAT FLOAT \[0\.0 1\.0\]",
    r"  --env.mode {FAST,SLOW} \[(FAST|SLOW)\]",
    r"  --help +Show this text\.",
  ):
    assert re.search(f"^{line.replace('|', chr(92) + '|', 1) if ' | ' in line else line}", text, re.MULTILINE), line
  assert "hook" not in text
  assert max(map(len, text.splitlines())) <= 120


def test_help_can_be_searched() -> None:
  text = help_of("--env.rewards.foot_slip.w")
  assert re.search(r"--env.rewards.foot-slip.weight FLOAT \[-0.1\]\s+Factor of the term\.", text)
  assert "num-envs" not in text
  assert help_of("foot slip.w").count("--env") == 1
  with pytest.raises(UsageError, match=r"no flag has 'qqq' in its name\.$"):
    help_of("qqq")
  with pytest.raises(UsageError, match=r"no flag has 'foot-slp' in its name\. Nearest: foot-slip\."):
    help_of("foot_slp")


def test_completion_has_tasks_and_flags(capsys: pytest.CaptureFixture[str]) -> None:
  line = Line(env=config())
  print_completion({"Task": line, "Other": line}, prog="train", words=["--tyro-print-completion", "bash"])
  script = capsys.readouterr().out
  assert "Task" in script
  assert "Other" in script
  assert "--env.rewards.foot-slip.weight" in script
  for arguments in (["--tyro-print-completion"], ["--tyro-print-completion", "cmd"]):
    with pytest.raises(UsageError, match=r"expected bash\|zsh\|tcsh\|fish"):
      print_completion({"Task": line}, prog="train", words=arguments)
