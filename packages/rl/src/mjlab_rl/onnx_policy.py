"""Policies exported to ONNX, in the environment of their task."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from mjlab_core import printable
from mjlab_core.errors import FileError
from mjlab_core.files import reading
from mjlab_core.names import check_name

from mjlab_rl.checkpoint import refuse, shape_problems
from mjlab_rl.config import RslRlBaseRunnerCfg
from mjlab_rl.env_protocol import RlEnv
from mjlab_rl.onnx_metadata import metadata_differences

_MAX_BYTES = 2**30
_DTYPES = {"tensor(double)": np.float64, "tensor(int64)": np.int64, "tensor(int32)": np.int32}


class OnnxPolicy:
  """A network exported with `export_policy_to_onnx`, or by mjlab 1.x, run by ONNX Runtime world by world.

  Inputs are read by name: "obs", the image groups, "time_step" (the step of a motion), and recurrent states "NAME_in"
  with an output "NAME_out". Outputs other than "actions" and the states are ignored. Metadata is compared with the
  environment.

  Args:
    path: The file.
    agent: Configuration of the learner: the observation groups that the network sees.
    env: Environment that it acts in.

  Raises:
    FileError: It cannot be read, an input has another name, or it does not fit the environment.
  """

  def __init__(self, path: Path, agent: RslRlBaseRunnerCfg, env: RlEnv) -> None:
    # ONNX Runtime, which is not for viewers of checkpoints.
    from mjlab_deploy.policy import open_graph

    self._path, self._env = path, env
    self._groups, self._clip = list(agent.obs_groups[agent.policy]), agent.clip_actions
    with reading("policy", path, _MAX_BYTES):
      self._session: Any = open_graph(str(path))
      inputs = self._session.get_inputs()
      # A size that the file leaves open is that of one world.
      self._shapes = {item.name: [n if isinstance(n, int) else 1 for n in item.shape] for item in inputs}
      self._dtypes = {item.name: _DTYPES.get(item.type, np.float32) for item in inputs}
      self._outputs = [item.name for item in self._session.get_outputs()]
      self._read_names()
      metadata = self._session.get_modelmeta().custom_metadata_map
      refuse(f"policy {path}:", metadata_differences(metadata, env, self._groups))
    self.reset(None)

  def _read_names(self) -> None:
    """Find the meaning of each input and output by its name."""
    names = list(self._shapes)
    self._images = [group for group in self._groups if len(self._shapes.get(group, ())) == 4]
    self._memory_names = {
      name: f"{name[:-3]}_out" for name in names if name.endswith("_in") and f"{name[:-3]}_out" in self._outputs
    }
    left = [name for name in names if name not in (*self._images, *self._memory_names, "time_step")]
    self._input = left[0] if len(left) == 1 else "obs"
    for name in left:
      known = [self._input, "time_step", *self._groups, "h_in", "c_in"]
      check_name("meaning of input", printable(name, 80), dict.fromkeys(known))
    actions = [name for name in self._outputs if name not in self._memory_names.values()]
    self._action = check_name("output", actions[0] if len(actions) == 1 else "actions", actions)

  def __call__(self, observations: Mapping[str, torch.Tensor]) -> torch.Tensor:
    """Return actions (num_envs, num_actions) for observations by group.

    Raises:
      FileError: The network does not take such observations or does not return such actions.
    """
    with reading("policy", self._path):
      trained = [self._shapes[group][1:] for group in self._images]
      now = [observations[group].shape[1:] for group in self._images]
      refuse(f"policy {self._path}:", shape_problems(self._images, trained, now))
      vectors = [observations[group] for group in self._groups if group not in self._images]
      feed = {self._input: torch.cat(vectors, dim=-1), **{group: observations[group] for group in self._images}}
      if "time_step" in self._shapes:
        feed["time_step"] = self._time_step()[:, None]
      arrays = {name: value.cpu().numpy().astype(self._dtypes[name]) for name, value in feed.items()}
      worlds = range(self._env.num_envs)
      rows = [self._act(i, {name: value[i : i + 1] for name, value in arrays.items()}) for i in worlds]
      result = torch.from_numpy(np.concatenate(rows).astype(np.float32)).to(self._env.device)
      return result if self._clip is None else result.clamp(-self._clip, self._clip)

  def _time_step(self) -> torch.Tensor:
    """Return the frame of the motion that each world follows, or the step of its episode, (num_envs,)."""
    manager: Any = getattr(self._env, "command_manager", None)
    for name in getattr(manager, "active_terms", ()):
      if isinstance(frame := getattr(manager.get_term(name), "frame", None), torch.Tensor):
        return frame
    return self._env.episode_length_buf

  def _act(self, world: int, feed: dict[str, np.ndarray]) -> np.ndarray:
    """Return the actions of one world, (1, num_actions), and keep its recurrent states."""
    memory = {name: states[world] for name, states in self._memory.items()}
    values = dict(zip(self._outputs, self._session.run(None, feed | memory), strict=True))
    for name, output in self._memory_names.items():
      self._memory[name][world] = values[output]
    actions, wanted = np.asarray(values[self._action]), (1, self._env.action_manager.total_action_dim)
    if actions.shape != wanted:
      raise FileError(f"does not fit: its actions are {actions.dtype} {actions.shape}, the environment takes {wanted}")
    return actions

  def reset(self, dones: torch.Tensor | None) -> None:
    """Clear the recurrent states of these worlds, bool (num_envs,); None: of all."""
    if dones is None:
      sizes = {name: (self._env.num_envs, *self._shapes[name]) for name in self._memory_names}
      self._memory = {name: np.zeros(size, np.float32) for name, size in sizes.items()}
    else:
      for memory in self._memory.values():
        memory[dones.cpu().numpy().astype(bool)] = 0.0
