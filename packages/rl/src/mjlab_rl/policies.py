"""Trained policies to be watched: what a checkpoint or an exported network does for the observations of any worlds."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict

from mjlab_rl.checkpoint import CheckpointError, check_shapes_seen
from mjlab_rl.config import RslRlBaseRunnerCfg
from mjlab_rl.console import Console
from mjlab_rl.distillation import runner_class
from mjlab_rl.env_protocol import RlEnv
from mjlab_rl.runner import MjlabOnPolicyRunner
from mjlab_rl.vec_env import RslRlVecEnvWrapper


class CheckpointPolicy:
  """The mean action of the policy in a checkpoint, which was trained by reinforcement or distilled.

  Args:
    env: Worlds it is to act in; reset on construction.
    agent: Configuration of the learner that it was trained with.
    runner: Runner class of the task; None: the standard one for such a learner.
  """

  def __init__(self, env: RlEnv, agent: RslRlBaseRunnerCfg, runner: type[MjlabOnPolicyRunner] | None = None) -> None:
    wrapped = RslRlVecEnvWrapper(env, clip_actions=agent.clip_actions)
    device = str(env.device)
    kind = runner or runner_class(agent)
    self._runner = kind(wrapped, agent.for_inference(), None, device, console=Console("quiet"))
    self._policy = self._runner.get_inference_policy(device)
    self._clip = agent.clip_actions
    self._num_envs = env.num_envs

  def load(self, path: Path) -> None:
    """Act as this checkpoint does from now on; what was remembered is forgotten.

    Raises:
      CheckpointError: it cannot be read or does not fit; nothing has been changed then.
    """
    self._runner.load_policy(path)
    self.reset(None)

  def __call__(self, observations: Mapping[str, Any]) -> torch.Tensor:
    """Actions (num_envs, num_actions) for observations by group."""
    actions = self._policy(TensorDict(dict(observations), batch_size=[self._num_envs]))
    return actions if self._clip is None else actions.clamp(-self._clip, self._clip)

  def reset(self, dones: torch.Tensor | None) -> None:
    """Forget what was remembered of these worlds, bool (num_envs,); None: of all."""
    self._policy.reset(dones)


class OnnxPolicy:
  """A network exported with `export_policy_to_onnx`, run by ONNX's own reference on the host: slow, but nothing else.

  Args:
    path: The file.
    agent: Configuration of the learner: which observation groups the network sees.
    num_envs: Worlds it acts in.

  Raises:
    CheckpointError: it cannot be read.
  """

  def __init__(self, path: Path, agent: RslRlBaseRunnerCfg, num_envs: int) -> None:
    import onnx
    from onnx.reference import ReferenceEvaluator

    if not path.is_file():
      raise CheckpointError(f"policy {path}: no such file")
    try:
      model = onnx.load(path)
      self._network = ReferenceEvaluator(model)
    except Exception as error:
      raise CheckpointError(f"policy {path}: not an ONNX network ({' '.join(str(error).split())[:200]})") from error
    self._path = path
    self._groups = agent.obs_groups[agent.policy]
    self._clip = agent.clip_actions
    inputs = {value.name: [d.dim_value for d in value.type.tensor_type.shape.dim] for value in model.graph.input}
    self._input = next(iter(inputs))
    self._images = [group for group in self._groups if group in inputs and group != self._input]
    remembered = [name for name in inputs if name != self._input and name not in self._images]
    self._shapes = {name: shape[1:] for name, shape in inputs.items()}
    self._width = inputs[self._input][-1]
    # A recurrent network takes its memory in, (layers, worlds, width), and gives it back, in the same order.
    self._memory = {name: np.zeros((inputs[name][0], num_envs, inputs[name][2]), np.float32) for name in remembered}

  def __call__(self, observations: Mapping[str, torch.Tensor]) -> torch.Tensor:
    """Actions (num_envs, num_actions) for observations by group."""
    seen = torch.cat([observations[group] for group in self._groups if group not in self._images], dim=-1)
    if self._width not in (0, seen.shape[-1]):
      raise CheckpointError(
        f"policy {self._path} does not fit: it takes {self._width} observations, here are {seen.shape[-1]}"
      )
    shown = {self._input: seen, **{group: observations[group] for group in self._images}}
    now = [shown[group].shape[1:] for group in self._images]
    check_shapes_seen(self._path, self._images, [self._shapes[group] for group in self._images], now)
    feed = {name: value.float().cpu().numpy() for name, value in shown.items()}
    if self._images:
      # What has convolutions was exported for one world alone.
      alone = [self._run({name: value[i : i + 1] for name, value in feed.items()}, [i]) for i in range(len(seen))]
      actions, *memory = (np.concatenate(values, axis=min(n, 1)) for n, values in enumerate(zip(*alone, strict=True)))
    else:
      actions, *memory = self._run(feed, slice(None))
    self._memory = dict(zip(self._memory, memory, strict=True))
    result = torch.from_numpy(actions.astype(np.float32)).to(seen.device)
    return result if self._clip is None else result.clamp(-self._clip, self._clip)

  def _run(self, feed: dict[str, np.ndarray], worlds: Any) -> list[np.ndarray]:
    memory = {name: value[:, worlds] for name, value in self._memory.items()}
    return [np.array(value) for value in self._network.run(None, {**feed, **memory})]

  def reset(self, dones: torch.Tensor | None) -> None:
    """Forget what was remembered of these worlds, bool (num_envs,); None: of all."""
    worlds = slice(None) if dones is None else dones.cpu().numpy().astype(bool)
    for memory in self._memory.values():
      memory[:, worlds] = 0.0
