"""Training loop of off-policy learners."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, cast

import msgspec
import torch
from mjlab_core import printable
from mjlab_core.errors import FileError
from mjlab_core.io.files import reading
from msgspec import Meta, Struct
from tensordict import TensorDict

from mjlab_rl.offpolicy.algorithm import OffPolicyAlgorithm
from mjlab_rl.offpolicy.config import OffPolicyRunnerCfg
from mjlab_rl.runner import MjlabOnPolicyRunner
from mjlab_rl.runs import checkpoint

REPLAY_NAME = "replay.pt"
_MAX_BYTES = 128 * 2**30
_Count = Annotated[int, Meta(ge=0)]


class _State(Struct):
  """Schema of the state of an algorithm; others may have more."""

  rounds_done: _Count
  steps_done: _Count
  due: Annotated[float, Meta(ge=0)]
  modules: dict[str, dict[str, torch.Tensor]]


class _Rows(Struct):
  num_steps: _Count
  steps_added: _Count
  count: torch.Tensor
  rows: torch.Tensor
  reward: torch.Tensor
  marks: torch.Tensor


class _ReplayFile(Struct):
  format: Literal[1]
  checkpoint: str
  replay: _Rows
  worlds: dict[str, torch.Tensor]


class MjlabOffPolicyRunner(MjlabOnPolicyRunner):
  """`MjlabOnPolicyRunner` for an `OffPolicyAlgorithm`: updates follow each step of all worlds.

  An iteration is `num_steps_per_env` steps with their updates, and one synchronisation at its end.
  """

  agent_cfg: OffPolicyRunnerCfg

  def __init__(self, *args: Any, **options: Any) -> None:
    super().__init__(*args, **options)
    self.algorithm = cast("OffPolicyAlgorithm", self.alg)
    """The algorithm."""
    self._spans: list[tuple[Any, Any]] = []
    replay, cfg = self.algorithm.replay, self.agent_cfg.algorithm
    saved = "saved with checkpoints" if self.agent_cfg.save_replay else "not saved"
    self.console.say(
      f"replay memory: {replay.num_steps} steps of {replay.num_envs} worlds, {replay.num_bytes / 1e9:.2f} GB on "
      f"{self.device}, {saved}; {cfg.updates_per_step:g} updates of {cfg.batch_size} transitions a step"
    )

  def _collect(self, obs: TensorDict) -> TensorDict:
    self._spans.clear()
    obs = super()._collect(obs)
    self._updating = sum(
      end - start if isinstance(start, float) else start.elapsed_time(end) / 1e3 for start, end in self._spans
    )
    return obs

  def _step(self, obs: TensorDict) -> tuple[TensorDict, torch.Tensor, torch.Tensor]:
    obs, rewards, dones = self.algorithm.collect(self.env, obs)
    with self._update_precision():
      start = self._clock()
      self.algorithm.update()
      self._spans.append((start, self._clock()))
    return obs, rewards, dones

  def _clock(self) -> Any:
    """Return the present time [s], on a GPU as an event, which can be read after a synchronisation."""
    if self._torch_device.type != "cuda":
      return time.perf_counter()
    event = torch.cuda.Event(enable_timing=True)
    event.record()
    return event

  def _update(self, obs: TensorDict) -> dict[str, float]:
    del obs
    figures = self.algorithm.figures()
    values = torch.stack(list(figures.values())).tolist()
    rate = self.algorithm.learning_rate
    self.algorithm.set_learning_rate()
    return dict(zip(figures, values, strict=True)) | {"learning_rate": rate}

  def save(self, path: str, infos: dict[str, Any] | None = None) -> None:
    super().save(path, infos)
    if self.agent_cfg.save_replay:
      file = Path(path)
      state = {"format": 1, "checkpoint": file.name, "replay": self.algorithm.replay.state_dict()}
      state["worlds"] = self.algorithm.worlds
      checkpoint.write_checkpoint(file.parent / self._replay_name, state)

  @property
  def _replay_name(self) -> str:
    """Name of the file of this process."""
    return REPLAY_NAME if self.ranks.is_first else f"replay_{self.ranks.rank}.pt"

  def _check(self, path: Path, state: Mapping[str, Any], wanted: Sequence[str]) -> None:
    algorithm = state.get("algorithm_state_dict")
    if algorithm is None:
      raise FileError(f"checkpoint {path}: it is not of an off-policy run; --init-from takes its policy alone")
    msgspec.convert(algorithm, _State, dec_hook=checkpoint.as_tensor)
    for name, part in self.algorithm.modules.items():
      problems = checkpoint.network_problems(name, algorithm["modules"].get(name, {}), part.state_dict())
      checkpoint.refuse(f"checkpoint {path}", problems)
    super()._check(path, state, wanted)

  def _load_worlds(self, path: Path, state: dict[str, Any]) -> None:
    super()._load_worlds(path, state)
    if not self._load_replay(path):
      steps = max(self.agent_cfg.algorithm.learning_starts, self.agent_cfg.algorithm.n_step)
      self.console.say(f"The replay memory is new; updates begin again after {steps} steps.")

  def _load_replay(self, checkpoint_path: Path) -> bool:
    """Restore the replay memory if the one of this checkpoint is there and fits; return True then."""
    path = checkpoint_path.parent / self._replay_name
    if not path.is_file() or not self.is_world_state_restored:
      return False
    with reading("replay memory", path, _MAX_BYTES):
      found: Mapping[str, Any] = torch.load(path, map_location="cpu", weights_only=True, mmap=True)
      msgspec.convert(found, _ReplayFile, dec_hook=checkpoint.as_tensor)
      if found["checkpoint"] != checkpoint_path.name:
        self.console.say(f"{path} belongs to {printable(found['checkpoint'], 60)} and is not loaded.")
        return False
      if problem := self.algorithm.replay.problem(found["replay"]):
        self.console.say(f"{path} does not fit and is not loaded: {problem}.")
        return False
      self.algorithm.replay.load_state_dict(found["replay"])
      for name, value in self.algorithm.worlds.items():
        value.copy_(found["worlds"][name])
    return True
