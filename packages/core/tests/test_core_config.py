"""Unknown keywords of config dataclasses."""

import copy
import pickle
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import pytest
from mjlab_core import Config, ConfigError, config


@dataclass(kw_only=True)
class Motor(Config):
  stiffness: float = 1.0
  damping: float = 0.1


@dataclass(kw_only=True, frozen=True)
class Servo(Config):
  stiffness: float = 1.0


class Own(Config):
  def __init__(self, size: int, **options: float) -> None:
    self.size, self.options = size, options


class Abstract(Config, ABC):
  @abstractmethod
  def build(self) -> None: ...


def test_a_misspelt_keyword_names_the_nearest_field_and_all_are_reported_at_once() -> None:
  with pytest.raises(ConfigError) as caught:
    Motor(stifness=2.0, dampin=0.2)  # type: ignore
  assert caught.value.problems == (
    "Motor: field 'stifness' does not exist. Nearest: stiffness. All 2: stiffness, damping.",
    "Motor: field 'dampin' does not exist. Nearest: damping. All 2: stiffness, damping.",
  )


def test_a_former_name_is_answered_by_the_new_one_also_in_subclasses(monkeypatch: pytest.MonkeyPatch) -> None:
  monkeypatch.setitem(config.FORMER_FIELDS, "Motor", {"kp": "stiffness", "delay": "wrap it"})

  @dataclass(kw_only=True)
  class Geared(Motor):
    ratio: float = 1.0

  with pytest.raises(ConfigError, match=r"Geared: field 'kp' does not exist: it is called 'stiffness' here. See docs/"):
    Geared(kp=1.0)  # type: ignore
  with pytest.raises(ConfigError, match="'delay' does not exist: wrap it"):
    Geared(delay=1)  # type: ignore


def test_configs_stay_what_dataclasses_are() -> None:
  motor = Motor(stiffness=3.0)
  assert copy.deepcopy(motor) == pickle.loads(pickle.dumps(motor)) == replace(motor) == motor
  assert replace(Servo(), stiffness=2.0).stiffness == 2.0
  assert Own(3, speed=1.0).options == {"speed": 1.0}
  with pytest.raises(TypeError, match="abstract"):
    Abstract()  # type: ignore
