"""State of one process of a run: worlds, statistics, hidden states of networks and random generators."""

import contextlib
import io
import random
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from mjlab_core import printable
from rsl_rl.modules import RNN

from mjlab_rl.env_protocol import RlEnv
from mjlab_rl.processes.ranks import Ranks
from mjlab_rl.reports.episode_statistics import EpisodeStatistics
from mjlab_rl.runs.checkpoint import refuse


@dataclass(frozen=True)
class ProcessState:
  """State of a process besides the learner, which all processes share."""

  env: RlEnv
  """Its environment."""
  statistics: EpisodeStatistics
  """Its episodes."""
  memories: Sequence[RNN]
  """Recurrent layers of its networks."""
  device: torch.device
  """Device of the learner."""

  def state_dict(self) -> dict[str, Any]:
    """Return the state as tensors and plain values."""
    return {
      "env": self.env.state_dict(),
      "statistics": self.statistics.state_dict(),
      "hidden_states": [memory.hidden_state for memory in self.memories],
      "rng": _rng_state(self.device),
    }

  def load(self, saved: Sequence[Mapping[str, Any]], num_envs: int, ranks: Ranks) -> str:
    """Restore the worlds; if they do not fit, all worlds start new, with the saved counters and past episodes.

    Args:
      saved: States of the processes of a run.
      num_envs: Number of worlds in each of them.
      ranks: Place of this process; every process must call it.

    Returns:
      The reason if the worlds of a process do not fit.

    Raises:
      FileError: The hidden states do not fit the networks; nothing has been changed then.
    """
    was, now, reason = len(saved), ranks.world_size, ""
    if was != now:
      reason = f"it was saved by {was} process{'es' * (was > 1)}, there {'are' if now > 1 else 'is'} {now} now"
    elif num_envs != self.env.num_envs:
      reason = f"it was saved with {num_envs} worlds, there are {self.env.num_envs} now"
    own = saved[0 if reason else ranks.rank]
    # None: there was no step yet; earlier versions also wrote it for networks without memory.
    hidden_states = [hidden for hidden in own["hidden_states"] if hidden is not None]
    refuse("its world state", _hidden_state_problems(hidden_states, self.memories, num_envs))
    if not reason:
      try:
        self.env.load_state_dict(own["env"])
      except (ValueError, LookupError, RuntimeError, TypeError, AttributeError) as error:
        reason = printable(error)
    # All processes or none, because they share the counters.
    reason = next(filter(None, ranks.gather(reason)), "")
    if reason:
      self.env.reset()
      self.env.load_progress(own["env"])
    else:
      for hidden, memory in zip(hidden_states, self.memories, strict=False):
        is_pair = isinstance(hidden, (tuple, list))
        memory.hidden_state = tuple(part.to(self.device) for part in hidden) if is_pair else hidden.to(self.device)
      _restore_rng_state(own["rng"], self.device)
    self.statistics.load_state_dict(own["statistics"], same_worlds=not reason)
    return reason


def pack(state: dict[str, Any]) -> bytes:
  """Return tensors and plain values as bytes, to send to another process."""
  packed = io.BytesIO()
  torch.save(state, packed)
  return packed.getvalue()


def unpack(packed: bytes) -> dict[str, Any]:
  """Return the state of `pack`, on the host."""
  return torch.load(io.BytesIO(packed), map_location="cpu", weights_only=True)


def _hidden_state_problems(saved: Sequence[Any], memories: Sequence[RNN], num_envs: int) -> Iterator[str]:
  """Yield a line for each recurrent layer that its saved hidden state does not fit; without any, none is needed."""
  if saved and len(saved) != len(memories):
    yield f"it has {len(saved)} hidden states for {len(memories)} recurrent networks"
  for number, (hidden, memory) in enumerate(zip(saved, memories, strict=False)):
    parts = hidden if isinstance(hidden, (tuple, list)) else (hidden,)
    shape = (memory.rnn.num_layers, num_envs, memory.rnn.hidden_size)
    shapes = [shape] * (2 if isinstance(memory.rnn, torch.nn.LSTM) else 1)
    if [getattr(part, "shape", None) for part in parts] != shapes:
      yield f"hidden state {number}"


def _rng_state(device: torch.device) -> dict[str, Any]:
  """Return the state of the generators of torch, on the host and on `device`, of NumPy and of Python."""
  name, keys, *others = np.random.get_state(legacy=True)  # noqa: NPY002
  state: dict[str, Any] = {
    "torch": torch.get_rng_state(),
    "numpy": (name, torch.from_numpy(np.asarray(keys, dtype=np.int64)), *others),
    "python": random.getstate(),
  }
  if device.type == "cuda":
    state["cuda"] = torch.cuda.get_rng_state(device)
  return state


def _restore_rng_state(state: dict[str, Any], device: torch.device) -> None:
  """Restore every generator, except the generator of a device of another kind."""
  torch.set_rng_state(state["torch"])
  name, keys, *others = state["numpy"]
  np.random.set_state((name, keys.numpy().astype(np.uint32), *others))  # noqa: NPY002
  version, internal, gauss = state["python"]
  random.setstate((version, tuple(internal), gauss))
  if device.type == "cuda" and "cuda" in state:
    torch.cuda.set_rng_state(state["cuda"], device)


@contextlib.contextmanager
def set_for_now(get: Callable[[], Any], set_to: Callable[[Any], None], value: Any) -> Generator[None]:
  """Change a setting of torch on entering, and back on leaving."""
  before = get()
  set_to(value)
  try:
    yield
  finally:
    set_to(before)
