"""Updates that hold the actor, while the critic learns at the start of a run."""

import contextlib
from collections.abc import Generator
from typing import Any

import torch


@contextlib.contextmanager
def actor_held(algorithm: Any) -> Generator[None]:
  """Put the actor back on leaving: its weights and normaliser, its part of the optimiser's state, and the step size.

  The update is the same as in other iterations, and everything is written in place, so that it can be a CUDA graph.
  """
  kept = {name: value.clone() for name, value in algorithm.actor.state_dict().items()}
  rate = algorithm.learning_rate
  yield
  with torch.no_grad():
    for name, value in algorithm.actor.state_dict().items():
      value.copy_(kept[name])
    # The optimiser's state of the actor comes from updates that were put back.
    for parameter in algorithm.actor.parameters():
      for value in algorithm.optimizer.state.get(parameter, {}).values():
        if isinstance(value, torch.Tensor):
          value.zero_()
  set_learning_rate(algorithm, rate)


def set_learning_rate(algorithm: Any, rate: float) -> None:
  """Set the step size of an algorithm of rsl-rl and of its optimiser."""
  algorithm.learning_rate = rate
  for group in algorithm.optimizer.param_groups:
    group["lr"] = rate
