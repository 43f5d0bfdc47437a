"""The matching rule and its messages."""

import subprocess
import sys

import pytest
from mjlab_core import UnknownNameError, match_names, match_values, match_values_full, nearest, unknown

LEGS = [f"{leg}_{part}_joint" for leg in ("FL", "FR", "RL", "RR") for part in ("hip", "thigh", "calf")]


def test_patterns_match_whole_names_in_the_order_of_the_names() -> None:
  assert match_names(("R._hip_joint", "FL_.*"), LEGS, what="joint") == ([0, 1, 2, 6, 9], [*LEGS[:3], LEGS[6], LEGS[9]])
  assert match_names(".*", LEGS, what="joint")[0] == list(range(12))
  with pytest.raises(UnknownNameError):
    match_names("FL_hip", LEGS, what="joint")


def test_preserve_order_follows_the_patterns_then_the_names() -> None:
  ids, names = match_names(["RR_.*", "FL_hip_joint"], LEGS, what="joint", preserve_order=True)
  assert ids == [9, 10, 11, 0]
  assert names == [LEGS[i] for i in ids]


def test_a_pattern_without_a_match_names_the_nearest_and_all() -> None:
  with pytest.raises(UnknownNameError) as error:
    match_names(["FR_.*", "left_hip_.*"], LEGS, what="joint", owner="entity 'robot'")
  assert str(error.value) == (
    "entity 'robot': pattern 'left_hip_.*' matches no joint. Nearest: FL_hip_joint, FR_hip_joint, RL_hip_joint. "
    f"All 12: {', '.join(LEGS)}."
  )


def test_a_name_hit_twice_names_both_patterns() -> None:
  with pytest.raises(UnknownNameError, match=r"'FL_hip_joint' is matched by two patterns, 'FL_\.\*' and '\.\*hip"):
    match_names(["FL_.*", ".*hip.*"], LEGS, what="joint")


def test_a_broken_expression_and_an_empty_list_of_names_are_said_so() -> None:
  with pytest.raises(UnknownNameError, match=r"pattern 'FL_\(' is not a regular expression"):
    match_names("FL_(", LEGS, what="joint")
  with pytest.raises(UnknownNameError, match=r"matches no site\. There are none\."):
    match_names(".*", [], what="site")


def test_values_follow_their_pattern() -> None:
  ids, names, values = match_values({".*_calf_joint": 2.0, "FL_hip_joint": 1.0}, LEGS, what="joint")
  assert ids == [0, 2, 5, 8, 11]
  assert names == [LEGS[i] for i in ids]
  assert values == [1.0, 2.0, 2.0, 2.0, 2.0]


def test_full_values_cover_every_name_or_say_which_is_left() -> None:
  assert match_values_full(3.0, LEGS, what="joint") == [3.0] * 12
  assert match_values_full({"F.*": 1, "R.*": 2}, LEGS, what="joint") == [1] * 6 + [2] * 6
  assert match_values_full({"FL.*": 1}, LEGS[:4], what="joint", default=0) == [1, 1, 1, 0]
  assert match_values_full({"FL.*": 1}, LEGS[:4], what="joint", default=None) == [1, 1, 1, None]
  with pytest.raises(UnknownNameError, match=r"act: no pattern .* for joint FR_hip_joint\. Patterns: FL\.\*"):
    match_values_full({"FL.*": 1}, LEGS[:4], what="joint", owner="act")


def test_names_without_a_separate_pattern_have_the_value_for_all() -> None:
  values = match_values_full({".*": 1, "FL_.*": 2}, LEGS, what="joint")
  assert values == [2 if leg.startswith("FL") else 1 for leg in LEGS]
  assert match_values_full({".*": 1, ".*_joint": 2}, LEGS, what="joint") == [2] * len(LEGS)


def test_unknown_names_come_with_a_way_out() -> None:
  assert unknown("sensor", "feet_contact", ["self_collision", "feet_ground_contact"], owner="reward 'slip'") == (
    "reward 'slip': sensor 'feet_contact' does not exist. Nearest: feet_ground_contact. "
    "All 2: self_collision, feet_ground_contact."
  )
  assert nearest("zzz", LEGS) == []
  assert nearest("fl_HIP_joint", LEGS, n=1) == ["FL_hip_joint"]


def test_a_very_long_list_is_cut() -> None:
  message = unknown("geom", "foo", [f"geom{i}" for i in range(100)])
  assert "All 100: geom0," in message
  assert message.endswith("and 40 more.")


def test_matching_names_imports_no_torch() -> None:
  code = "import sys; from mjlab_core import match_names, nearest; sys.exit('torch' in sys.modules)"
  assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
