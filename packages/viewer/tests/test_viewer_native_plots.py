"""Plots over MuJoCo's window: pages and curves."""

import mujoco
import numpy as np
import pytest
from mjlab_viewer import Snapshot
from mjlab_viewer.native.plots import NativePlots

WINDOW = mujoco.MjrRect(10, 20, 900, 600)


def moment(step: int, values: list[float], world: int = 0) -> Snapshot:
  signals = {"rewards": np.array(values), "ends": np.zeros(1)}
  return Snapshot(worlds=(world,), data={}, model={}, signals=signals, drawings=[], step=step)


def plots(count: int) -> NativePlots:
  made = NativePlots({"rewards": [f"term_{i}" for i in range(count)], "ends": ["fell"]})
  made.turn()
  return made


def curve(figure: mujoco.MjvFigure, line: int) -> np.ndarray:
  return figure.linedata[line, : 2 * figure.linepnt[line]].reshape(-1, 2)


def test_pages_are_turned_group_by_group_and_end_with_none() -> None:
  made = NativePlots({"rewards": [f"term_{i}" for i in range(14)], "ends": ["fell"]})
  assert made.page is None
  titles = []
  for _ in range(3):
    made.turn()
    assert made.page is not None
    titles.append((made.page.title, len(made.page.names)))
  assert titles == [("rewards (1 of 2)", 12), ("rewards (2 of 2)", 2), ("ends", 1)]
  made.turn()
  assert made.page is None
  assert made.figures(WINDOW, 0.02) == []
  empty = NativePlots({"rewards": []})
  empty.turn()
  assert empty.page is None


def test_curves_are_the_values_over_time_each_under_its_name() -> None:
  made = plots(6)
  for step in (3, 4, 7):
    made.add(moment(step, [float(10 * i + step) for i in range(6)]))
  first, second = made.figures(WINDOW, 0.5)
  figures = [first[1], first[1], first[1], first[1], second[1], second[1]]
  for number, figure in enumerate(figures):
    line = number % 4
    assert figure.linename[line] == f"term_{number}".encode()
    np.testing.assert_allclose(curve(figure, line), [[0.5 * step, 10 * number + step] for step in (3, 4, 7)])
  assert first[1].title == "rewards"
  np.testing.assert_allclose(first[1].range[0], [1.5, 3.5], atol=0.01)
  low, high = first[1].range[1]
  assert low < 3 < 37 < high < 40


def test_figures_are_below_one_another_in_the_right_third_of_the_window() -> None:
  made = plots(12)
  made.add(moment(0, [0.0] * 12))
  places = [(place.left, place.bottom, place.width, place.height) for place, _ in made.figures(WINDOW, 0.02)]
  assert places == [(610, 420, 300, 200), (610, 220, 300, 200), (610, 20, 300, 200)]


def test_another_world_begins_new_curves_and_a_moment_counts_once() -> None:
  made = plots(1)
  for step in (1, 2, 2, 2, 3):
    made.add(moment(step, [float(step)]))
  (_, figure) = made.figures(WINDOW, 1.0)[0]
  np.testing.assert_allclose(curve(figure, 0), [[1, 1], [2, 2], [3, 3]])
  made.add(moment(4, [5.0], world=2))
  (_, figure) = made.figures(WINDOW, 1.0)[0]
  np.testing.assert_allclose(curve(figure, 0), [[4, 5]])


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_values_that_are_not_finite_are_left_out(bad: float) -> None:
  made = plots(2)
  for step, value in enumerate((1.0, bad, 3.0)):
    made.add(moment(step, [value, bad]))
  (_, figure) = made.figures(WINDOW, 1.0)[0]
  np.testing.assert_allclose(curve(figure, 0), [[0, 1], [2, 3]])
  assert figure.linepnt[1] == 0
  assert np.isfinite(figure.range).all()


@pytest.mark.parametrize("constant", [0.0, 1e6, -3e4])
def test_a_constant_has_a_range_to_be_seen_in(constant: float) -> None:
  made = plots(1)
  made.add(moment(0, [constant]))
  (_, figure) = made.figures(WINDOW, 1.0)[0]
  low, high = figure.range[1]
  assert low < np.float32(constant) < high
