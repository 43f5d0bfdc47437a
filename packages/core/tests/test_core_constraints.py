"""Constraints that config fields declare."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import pytest
from mjlab_core import ConfigError
from mjlab_core.constraints import (
  Ascending,
  Bounds,
  Finite,
  Items,
  Limits,
  NonNegative,
  NonNegativeRange,
  Positive,
  PositiveCount,
  Range,
  Share,
  check_fields,
  field_problem,
)

if TYPE_CHECKING:
  from decimal import Decimal


@dataclass(kw_only=True)
class Base:
  mode: Literal["spin", "scan"] = "spin"
  rows: PositiveCount = 16
  period: int | Literal["decimation"] = 0


@dataclass(kw_only=True)
class Lidar(Base):
  noise: NonNegative = 0.0
  reach: Annotated[float, Limits(gt=0, finite=False)] = 1.0
  size: Positive | None = None
  fov: Annotated[tuple[float, float], Limits(ge=-90, le=90), Ascending()] = (-15.0, 15.0)
  rise: Annotated[tuple[float, ...], Ascending(strict=True)] = ()
  data: tuple[Literal["range", "normal"], ...] = ("range",)
  names: Annotated[tuple[str, ...], Items(ge=1, le=2, unique=True)] = ("hip",)
  gear: Annotated[float, Limits(nonzero=True)] = 1.0
  drop: Annotated[float, Limits(ge=0, lt=1)] = 0.0
  axis: tuple[Finite, Finite, Finite] | None = None
  offsets: Annotated[float | Mapping[str, float] | None, Limits(gt=0)] = None
  anything: Decimal | None = None


@pytest.mark.parametrize(
  "given",
  [
    {},
    {"rows": np.int64(3), "noise": np.float32(0.5), "reach": float("inf"), "size": 2},
    {"fov": [3.0, 3.0], "rise": (1, 2, 3), "axis": np.ones(3), "data": ()},
    {"offsets": {"hip": 1.0}, "anything": object(), "period": "decimation"},
    {"offsets": 2.0, "period": 3, "data": ("normal", "range"), "gear": -1.0},
  ],
)
def test_values_within_their_constraints_pass(given: dict[str, Any]) -> None:
  check_fields(Lidar(**given), "Lidar")


@pytest.mark.parametrize(
  ("name", "value", "message"),
  [
    ("mode", "spinn", "mode 'spinn' does not exist. Nearest: spin."),
    ("mode", 3, "mode must be 'spin' or 'scan', got 3"),
    ("rows", 0, "rows must be at least 1, got 0"),
    ("rows", 2.0, "rows must be a whole number, got 2.0"),
    ("rows", True, "rows must be a whole number, got True"),
    ("period", "decimaton", "period 'decimaton' does not exist. Nearest: decimation."),
    ("period", 2.5, "period must be a whole number or be 'decimation', got 2.5"),
    ("noise", -1.0, "noise must not be negative, got -1.0"),
    ("noise", float("inf"), "noise must be finite, got inf"),
    ("noise", "0.1", "noise must be a number, got '0.1'"),
    ("reach", 0.0, "reach must be positive, got 0.0"),
    ("reach", float("nan"), "reach must be a number, got nan"),
    ("size", 0, "size must be positive, got 0"),
    ("fov", (-15.0, 100.0), "fov must be in [-90, 90], got (-15.0, 100.0)"),
    ("fov", (15.0, -15.0), "fov must not fall, got (15.0, -15.0)"),
    ("fov", (15.0,), "fov must have 2 elements, got (15.0,)"),
    ("fov", 15.0, "fov must be a tuple, got 15.0"),
    ("rise", (1.0, 1.0), "rise must rise, got (1.0, 1.0)"),
    ("data", ("range", "nromal"), "data 'nromal' does not exist. Nearest: normal."),
    ("names", (), "names must have at least 1 element, got ()"),
    ("names", ("hip", "knee", "toe"), "names must have at most 2 elements, got ('hip', 'knee', 'toe')"),
    ("names", ("hip", "hip"), "names must name each element once, got ('hip', 'hip')"),
    ("gear", 0.0, "gear must not be zero, got 0.0"),
    ("drop", 1.0, "drop must be in [0, 1), got 1.0"),
    ("axis", (0.0, 1.0), "axis must have 3 elements, got (0.0, 1.0)"),
    ("axis", (0.0, 1.0, float("nan")), "axis must be a number"),
    ("offsets", "all", "offsets must be a number or be a mapping, got 'all'"),
    ("offsets", {"hip": "1"}, "offsets must be a number, got"),
    ("offsets", {"hip": 1.0, "knee": 0.0}, "offsets must be positive, got {'hip': 1.0, 'knee': 0.0}"),
  ],
)
def test_a_value_outside_is_refused_with_the_rule_and_the_value(name: str, value: Any, message: str) -> None:
  with pytest.raises(ConfigError) as error:
    check_fields(Lidar(**{name: value}), "Lidar")
  assert str(error.value).startswith(f"Lidar: {message}")


def test_all_problems_are_in_one_message() -> None:
  with pytest.raises(ConfigError) as error:
    check_fields(Lidar(rows=0, noise=-1.0), "Lidar")
  assert len(error.value.problems) == 2


@pytest.mark.parametrize(
  ("value", "hint", "problem"),
  [
    ((0, 1.0), Range, ""),
    ((1.0, math.inf), Range, "must be finite, got (1.0, inf)"),
    ([0.0, math.inf], Bounds, ""),
    ((math.nan, 1.0), Bounds, "must be a number, got (nan, 1.0)"),
    ((2, 1), Bounds, "must not fall, got (2, 1)"),
    ("ab", Range, "must be a tuple, got 'ab'"),
    ((-1.0, 1.0), NonNegativeRange, "must not be negative, got (-1.0, 1.0)"),
    (1.5, Share, "must be in [0, 1], got 1.5"),
    (3, str, "must be a string, got 3"),
    (1, bool, "must be a bool, got 1"),
    (True, float, "must be a number, got True"),
  ],
)
def test_one_value_is_checked_against_an_annotation(value: object, hint: Any, problem: str) -> None:
  assert field_problem(value, hint) == problem
