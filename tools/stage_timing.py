"""Time spent in chosen methods of an environment or its engine while it steps."""

import collections
import statistics
import time
from collections.abc import Callable
from itertools import pairwise

import torch
from mjlab_envs import ManagerBasedRlEnv

ENGINE_CALLS = {"step": "step", "forward": "forward", "reset": "reset"}
"""Everything that physics does within an environment step."""


def time_methods(
  env: ManagerBasedRlEnv, owner: object, methods: dict[str, str], step: Callable[[], None], steps: int
) -> dict[str, float]:
  """Median milliseconds per step in methods of `owner`, by the names given to them.

  On a GPU the step graph is split around the methods and events are recorded between its pieces.
  """
  time_them = _time_on_gpu if env.device.type == "cuda" else _time_on_cpu
  originals = {method: getattr(owner, method) for method in methods}
  try:
    return time_them(env, owner, originals, methods, step, steps)
  finally:
    for method, original in originals.items():
      setattr(owner, method, original)
    env.request_recapture("timing is over")


def _time_on_cpu(
  env: ManagerBasedRlEnv,
  owner: object,
  originals: dict[str, Callable[..., object]],
  methods: dict[str, str],
  step: Callable[[], None],
  steps: int,
) -> dict[str, float]:
  spent: dict[str, float] = collections.defaultdict(float)

  def wrapped(method: str) -> Callable[..., object]:
    def call(*arguments: object) -> object:
      begin = time.perf_counter()
      result = originals[method](*arguments)
      spent[methods[method]] += 1e3 * (time.perf_counter() - begin)
      return result

    return call

  for method in methods:
    setattr(owner, method, wrapped(method))
  samples = []
  for _ in range(steps):
    spent.clear()
    step()
    samples.append(dict(spent))
  return {name: statistics.median(sample.get(name, 0.0) for sample in samples) for name in methods.values()}


def _time_on_gpu(
  env: ManagerBasedRlEnv,
  owner: object,
  originals: dict[str, Callable[..., object]],
  methods: dict[str, str],
  step: Callable[[], None],
  steps: int,
) -> dict[str, float]:
  marks: list[tuple[str, torch.cuda.Event]] = []

  def mark(name: str) -> None:
    event = torch.cuda.Event(enable_timing=True)
    event.record()
    marks.append((name, event))

  def wrapped(method: str) -> Callable[..., object]:
    def call(*arguments: object) -> object:
      recorder = env.sim._recordings.recorder
      if recorder is None:
        return originals[method](*arguments)
      # Straight to the recorder: a mark neither reads nor writes state.
      recorder.interrupt(lambda: mark(""))
      result = originals[method](*arguments)
      recorder.interrupt(lambda: mark(methods[method]))
      return result

    return call

  for method in methods:
    setattr(owner, method, wrapped(method))
  env.request_recapture("timing")
  for _ in range(5):
    step()
  samples = []
  for _ in range(steps):
    marks.clear()
    step()
    torch.cuda.synchronize()
    spent: dict[str, float] = collections.defaultdict(float)
    for (_, before), (name, after) in pairwise(marks):
      spent[name] += before.elapsed_time(after)
    samples.append(spent)
  return {name: statistics.median(sample[name] for sample in samples) for name in methods.values()}
