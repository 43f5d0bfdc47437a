"""Policies exported to ONNX, run on the host."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from mjlab_core import printable
from mjlab_core.errors import FileError
from mjlab_core.io.files import reading

from mjlab_rl.bundles.onnx_metadata import metadata_differences
from mjlab_rl.config import RslRlBaseRunnerCfg
from mjlab_rl.env_protocol import RlEnv
from mjlab_rl.runs.checkpoint import refuse

_MAX_BYTES = 2**30


class OnnxPolicy:
  """Network exported as a policy for other runners, or by mjlab 1.x, run by ONNX Runtime world by world.

  Inputs are read by name: "obs", the image groups, "time_step" (the step of a motion), and recurrent states "NAME_in"
  with an output "NAME_out". Outputs other than "actions" and the states are ignored. Metadata is compared with the
  environment.

  Args:
    path: The file.
    agent: Configuration of the learner: the observation groups that the network sees.
    env: Environment that it acts in.

  Raises:
    FileError: It cannot be read, or it does not fit the environment.
  """

  def __init__(self, path: Path, agent: RslRlBaseRunnerCfg, env: RlEnv) -> None:
    # Neither is needed to view checkpoints.
    import onnx
    from mjlab_deploy.formats.onnx_graph import OnnxGraph

    self._path, self._env = path, env
    self._groups = list(agent.obs_groups[agent.policy])
    self._clip = agent.clip_actions
    with reading("policy", path, _MAX_BYTES):
      # ONNX Runtime does not read weights in other files, which rsl-rl writes.
      self._network = OnnxGraph(onnx.load(path).SerializeToString())
      self._input, self._images = self._read_inputs()
      refuse(f"policy {path}:", metadata_differences(self._network.metadata, env, self._groups))
      self._memory: list[dict[str, np.ndarray]] = [{} for _ in range(env.num_envs)]
      self.reset(None)

  def _read_inputs(self) -> tuple[str, list[str]]:
    """Return the input of vectors, and the image groups that are inputs."""
    inputs, states = self._network.inputs, self._network.states
    images = [group for group in self._groups if group != "obs" and len(inputs.get(group, ())) == 4]
    left = [name for name in inputs if name not in (*images, *states, "time_step")]
    vectors = left[0] if len(left) == 1 and len(inputs[left[0]]) == 2 else "obs"
    if vectors not in left:
      raise FileError(f"has no input 'obs' among its inputs: {printable(', '.join(inputs), 200) or 'none'}")
    return vectors, images

  def __call__(self, observations: Mapping[str, torch.Tensor]) -> torch.Tensor:
    """Return actions (num_envs, num_actions) for observations by group.

    Raises:
      FileError: The network does not take such observations or does not return such actions.
    """
    with reading("policy", self._path):
      seen = torch.cat([observations[group] for group in self._groups if group not in self._images], dim=-1)
      feed = {self._input: seen, **{group: observations[group] for group in self._images}}
      if "time_step" in self._network.inputs:
        feed["time_step"] = self._time_step()[:, None]
      arrays = {name: value.cpu().numpy() for name, value in feed.items()}
      rows = [
        self._act({name: value[i : i + 1] for name, value in arrays.items()}, memory)
        for i, memory in enumerate(self._memory)
      ]
      result = torch.from_numpy(np.concatenate(rows)).to(seen.device)
      return result if self._clip is None else result.clamp(-self._clip, self._clip)

  def _time_step(self) -> torch.Tensor:
    """Return the frame of the motion that each world follows, or the step of its episode, (num_envs,)."""
    manager: Any = getattr(self._env, "command_manager", None)
    for name in getattr(manager, "active_terms", ()):
      if isinstance(frame := getattr(manager.get_term(name), "frame", None), torch.Tensor):
        return frame
    return self._env.episode_length_buf

  def _act(self, feed: Mapping[str, np.ndarray], memory: dict[str, np.ndarray]) -> np.ndarray:
    """Return the action of one world, (1, num_actions), and update its recurrent states."""
    values, wanted = self._network.run({**feed, **memory}), (1, self._env.action_manager.total_action_dim)
    actions = values[self._network.action]
    if actions.shape != wanted:
      raise FileError(f"does not fit: its actions are {actions.shape}, the environment takes {wanted}")
    memory.update({name: values[output] for name, output in self._network.states.items()})
    return actions.astype(np.float32)

  def reset(self, dones: torch.Tensor | None) -> None:
    """Clear the recurrent states of these worlds, bool (num_envs,); None: of all."""
    for i, memory in enumerate(self._memory):
      if dones is None or bool(dones[i]):
        memory.update(self._network.zeros(*self._network.states))
