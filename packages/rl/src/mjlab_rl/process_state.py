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

from mjlab_rl.checkpoint import refuse
from mjlab_rl.env_protocol import RlEnv
from mjlab_rl.episode_statistics import EpisodeStatistics
from mjlab_rl.ranks import Ranks


@dataclass(frozen=True)
class ProcessState:
  """State of a process besides the learner, which all processes share."""

  env: RlEnv
  """Its environment."""
  statistics: EpisodeStatistics
  """Its episodes."""
  networks: Mapping[str, Any]
  """Networks with hidden states."""
  device: torch.device
  """Device of the learner."""

  def state_dict(self) -> dict[str, Any]:
    """Return the state as tensors and plain values."""
    return {
      "env": self.env.state_dict(),
      "statistics": self.statistics.state_dict(),
      "hidden_states": [network.get_hidden_state() for network in self.networks.values()],
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
    refuse("its world state", _hidden_state_problems(own["hidden_states"], self.networks, num_envs))
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
      _restore_hidden_states(own["hidden_states"], self.networks, self.device)
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


def _hidden_state_problems(saved: Sequence[Any], networks: Mapping[str, Any], num_envs: int) -> Iterator[str]:
  """Yield a line for each network that its saved hidden state does not fit."""
  for hidden, (name, network) in zip(saved, networks.items(), strict=True):
    rnn = getattr(getattr(network, "rnn", None), "rnn", None)
    parts = hidden if isinstance(hidden, (tuple, list)) else (hidden,)
    count = 2 if isinstance(rnn, torch.nn.LSTM) else 1
    shapes = [] if rnn is None else [(rnn.num_layers, num_envs, rnn.hidden_size)] * count
    if hidden is not None and [getattr(part, "shape", None) for part in parts] != shapes:
      yield f"hidden state of {name}"


def _restore_hidden_states(saved: Sequence[Any], networks: Mapping[str, Any], device: torch.device) -> None:
  """Set the hidden states of networks, which `_hidden_state_problems` has compared."""
  for hidden, network in zip(saved, networks.values(), strict=True):
    if hidden is not None:
      is_pair = isinstance(hidden, (tuple, list))
      network.reset(hidden_state=tuple(part.to(device) for part in hidden) if is_pair else hidden.to(device))


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
