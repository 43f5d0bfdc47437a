"""Terms of a manager compiled as one function by torch.compile."""

import logging
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from typing import Any

import torch
from mjlab_managers import ManagerBase
from mjlab_managers.terms.binding import Term, call_terms
from mjlab_managers.terms.watch import PlainTensors, Watch
from mjlab_sim import Simulation

_log = logging.getLogger("mjlab")
Values = list[torch.Tensor]


class CompiledTerms:
  """Evaluation of the terms of a manager as one compiled function.

  The operations of the terms are traced in their first call, as a recording of the step does it, and compiled together.
  Terms that cast rays, draw images or random numbers, or read the device run as they are.

  Args:
    sim: the simulation that terms read.
    rng: source of randomness of the terms.
    manager: the manager; this object becomes its `evaluate`.
  """

  def __init__(self, sim: Simulation, rng: torch.Generator, manager: ManagerBase[Any]) -> None:
    self._sim, self._rng, self._manager = sim, rng, manager
    self._programs: dict[tuple[Any, ...], Callable[[], Values]] = {}
    manager.evaluate = self

  def clear(self) -> None:
    """Trace again at the next call, because operations have changed."""
    self._programs.clear()

  def __call__(self, terms: Sequence[Term]) -> Values:
    # Model fields that are expanded have new memory.
    key = (*map(id, terms), self._sim.expanded_fields)
    if key not in self._programs:
      self._programs[key] = self._compile(terms)
    self._sim.forward()
    with torch.no_grad():
      return self._programs[key]()

  def _compile(self, terms: Sequence[Term]) -> Callable[[], Values]:
    arrays = PlainTensors()
    with torch.no_grad(), self._undone():
      own = [term for term in terms if not self._is_pure(term, arrays)]
      pure = [term for term in terms if term not in own]
      arrays.make_plain()
      graph = self._trace(pure, arrays)
    # Nothing computed while tracing may be read later.
    self._sim.expire()
    compiled = torch.compile(graph, fullgraph=True, dynamic=False)
    names = f"; as they are: {', '.join(term.name for term in own)}" if own else ""
    _log.info("%s: %d terms compiled%s", self._manager.label, len(pure), names)

    def evaluate() -> Values:
      values = dict(zip(pure, compiled(), strict=True))
      return [values[term] if term in values else term() for term in terms]

    return evaluate if pure else lambda: call_terms(terms)

  def _is_pure(self, term: Term, arrays: PlainTensors) -> bool:
    """Return True if a term consists of operations on tensors alone, all seen by a trace."""
    sensed, arrays.draws = self._sim.num_sensed, False
    self._sim.expire()
    with Watch() as watch, arrays:
      term()
    return not (watch.reads_host or arrays.draws or self._sim.num_sensed != sensed)

  def _trace(self, terms: Sequence[Term], arrays: PlainTensors) -> torch.fx.GraphModule:
    """Return the operations of terms, everything that follows from the state included."""
    # The compiler takes seconds to import.
    from torch.fx.experimental.proxy_tensor import make_fx

    def values() -> Values:
      with arrays:
        return call_terms(terms)

    self._sim.expire()
    return make_fx(values)()

  @contextmanager
  def _undone(self) -> Generator[None]:
    """Restore the state of the manager and of the generator afterwards."""
    put_back, generator = self._manager.remember(), self._rng.get_state()
    yield
    put_back()
    self._rng.set_state(generator)
