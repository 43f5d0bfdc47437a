"""Trial at build of the parts that otherwise run for the first time during a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

from mjlab_core import ConfigError, DebugDraw
from mjlab_managers import ManagerBase
from mjlab_managers.terms.binding import place_of
from mjlab_sim import Simulation


def rehearse(managers: Mapping[str, ManagerBase[Any]], drawers: Mapping[str, Callable[[DebugDraw], None]]) -> list[str]:
  """Call drawings once, and the terms that no manager called at build; return the errors, one line each."""
  problems: list[str] = []
  for name, draw in drawers.items():
    try:
      draw(cast(Any, _Sketch)())
    except Exception as error:
      problems.append(f"{name}: {type(error).__name__} in debug_draw{place_of(error)}: {error}")
  for manager in managers.values():
    try:
      manager.rehearse()
    except ConfigError as error:
      problems += error.problems
  return problems


def complete(state: dict[str, Any], sim: Simulation) -> None:
  """Add to the state of a simulation the model fields that got one value per world since it was taken."""
  now = sim.state_dict()
  for name, field in now["model"].items():
    if name not in state["model"]:
      state["model"][name] = state["shared"].pop(name, sim.default_field(name)).expand_as(field)
  state["default"] = now["default"] | state["default"]


class _Sketch(DebugDraw):
  """Drawing that takes every shape and shows none."""

  @property
  def worlds(self) -> Sequence[int]:
    return (0,)
