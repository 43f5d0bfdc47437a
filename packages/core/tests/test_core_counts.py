"""What is a count, and what only looks like one."""

import numpy as np
import pytest
from mjlab_core import why_no_count


@pytest.mark.parametrize("value", [1, 7, np.int64(3)])
def test_whole_numbers_from_the_least_on_are_counts(value: object) -> None:
  assert why_no_count(value, 1) == ""


@pytest.mark.parametrize(
  ("value", "reason"),
  [
    (0, "must be at least 1, got 0"),
    (2.0, "must be a whole number, got 2.0"),
    (True, "must be a whole number, got True"),
    ("4", "must be a whole number, got '4'"),
    (None, "must be a whole number, got None"),
    (float("nan"), "must be a whole number, got nan"),
  ],
)
def test_all_else_is_told_what_it_should_be(value: object, reason: str) -> None:
  assert why_no_count(value, 1) == reason
