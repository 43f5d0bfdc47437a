"""Networks and action distributions that rsl-rl does not have."""

import contextlib
import copy
import io
import math
from collections.abc import Mapping
from typing import Any, Literal, cast

import torch
from mjlab_core.errors import ConfigError
from rsl_rl.models import CNNModel
from rsl_rl.modules import CNN, RNN, GaussianDistribution, HiddenState
from tensordict import TensorDict
from torch import nn
from torch.nn.utils import get_total_norm


class Gaussian(GaussianDistribution):
  """rsl-rl's GaussianDistribution, bit for bit, without `torch.normal`, which reads back whether a std is negative."""

  def sample(self) -> torch.Tensor:
    """Draw actions, (num_envs, num_actions)."""
    with torch.no_grad():
      return torch.randn_like(self.mean).mul_(self.std).add_(self.mean)


def merge_moments(normalizer: Any, count: Any, delta: torch.Tensor, variance: torch.Tensor) -> None:
  """Update a normaliser of rsl-rl with new observations, in place and without a wait for the device.

  Args:
    normalizer: The normaliser.
    count: Number of observations.
    delta: Their mean minus the normaliser's, (1, dim).
    variance: Their variance, (1, dim).
  """
  mean, var, std = (dict(normalizer.named_buffers())[name] for name in ("_mean", "_var", "_std"))
  normalizer.count += count
  rate = count / normalizer.count
  change = rate * delta
  mean += change
  var += rate * (variance - var + delta * (delta - change))
  std.copy_(var.sqrt())


class ImageModel(CNNModel):
  """rsl-rl's CNNModel with an optional recurrent layer between the encoders and the hidden layers.

  Images go through their encoders, which may be shared with another network. Their features and the other observations
  go into the recurrent layer. Recurrent and other networks can be trained together.

  Args:
    obs: Observations by group, images (N, C, H, W).
    obs_groups: Groups of each network.
    obs_set: Name of this network.
    output_dim: Width of the output.
    cnn_cfg: Encoder settings, one for all image groups or one for each.
    cnns: Encoders of another network, to share; they stay in the optimiser and checkpoint of that network.
    rnn_type: Recurrent layer; None: none.
    rnn_hidden_dim: Width of the recurrent layer.
    rnn_num_layers: Number of recurrent layers.
    **options: Other arguments of CNNModel.
  """

  def __init__(
    self,
    obs: Any,
    obs_groups: dict[str, list[str]],
    obs_set: str,
    output_dim: int,
    *,
    cnn_cfg: dict[str, Any] | None = None,
    cnns: nn.ModuleDict | None = None,
    rnn_type: Literal["lstm", "gru"] | None = None,
    rnn_hidden_dim: int = 256,
    rnn_num_layers: int = 1,
    **options: Any,
  ) -> None:
    self.is_recurrent = rnn_type is not None
    encoders: Any = cnns
    if cnns is None:
      if not cnn_cfg:
        raise ConfigError("image groups need cnn_cfg, the settings of their encoders")
      images = {group: obs[group] for group in obs_groups[obs_set] if obs[group].dim() == 4}
      try:
        encoders = {group: self.make_encoder(image, **cnn_cfg.get(group, cnn_cfg)) for group, image in images.items()}
      except TypeError as error:
        raise ConfigError(f"cnn_cfg: {error}") from error
    # The parent prints that given encoders are shared.
    with contextlib.redirect_stdout(io.StringIO()):
      super().__init__(obs, obs_groups, obs_set, output_dim, cnns=encoders, **options)
    if cnns is not None:
      # An optimiser would step modules of two networks twice.
      del self.cnns
      object.__setattr__(self, "cnns", cnns)
    self.rnn = None
    if rnn_type is not None:
      first = cast("nn.Linear", self.mlp[0])
      self.rnn = RNN(first.in_features, rnn_hidden_dim, rnn_num_layers, rnn_type)
      self.mlp[0] = nn.Linear(rnn_hidden_dim, first.out_features)

  @staticmethod
  def make_encoder(images: torch.Tensor, **cfg: Any) -> nn.Module:
    """Return an encoder of such images, (N, C, H, W); `cfg` is CNNModel's `cnn_cfg`."""
    _, channels, height, width = images.shape
    return CNN(input_dim=(height, width), input_channels=channels, **cfg)

  def get_latent(
    self, obs: TensorDict, masks: torch.Tensor | None = None, hidden_state: HiddenState = None
  ) -> torch.Tensor:
    """Return the input of the hidden layers, (N, D), or (T, N, D) for trajectories (T, N, ...)."""
    # Convolutions take one batch of images.
    seen = super().get_latent(cast("TensorDict", obs.flatten(0, obs.dim() - 1))).unflatten(0, obs.shape)
    return seen if self.rnn is None else self.rnn(seen, masks, hidden_state).squeeze(0)

  def reset(self, dones: torch.Tensor | None = None, hidden_state: HiddenState = None) -> None:
    """Clear the hidden state of worlds that are done, (N,), or of all (None), or set it to `hidden_state`."""
    if self.rnn is not None:
      self.rnn.reset(dones, hidden_state)

  def get_hidden_state(self) -> HiddenState:
    """Return the hidden state, (layers, N, width), two of them for an LSTM; None for a network without."""
    return None if self.rnn is None else cast("HiddenState", self.rnn.hidden_state)

  def detach_hidden_state(self, dones: torch.Tensor | None = None) -> None:
    """Stop gradients through the hidden state of worlds that are done, (N,), or of all (None)."""
    if self.rnn is not None:
      self.rnn.detach_hidden_state(dones)

  def as_jit(self) -> nn.Module:
    """Return a copy for torch.jit: `forward(obs_1d, images)`; a recurrent model has `as_onnx` only."""
    if self.rnn is not None:
      raise ConfigError("a recurrent model with images is exported as ONNX only")
    return super().as_jit()

  def as_onnx(self, verbose: bool = False) -> nn.Module:
    """Return a copy for ONNX: observations, image groups and hidden states are inputs, actions and states outputs."""
    plain = super().as_onnx(verbose)
    return plain if self.rnn is None else _OnnxModel(self.rnn, plain)


def largest_weights(networks: Mapping[str, nn.Module]) -> dict[str, float]:
  """Return the largest weight of each network; losses of an update are from before its last step."""
  weights = {
    name: [v for v in network.state_dict().values() if v.is_floating_point()] for name, network in networks.items()
  }
  return {name: float(get_total_norm(values, math.inf)) for name, values in weights.items()}


class _OnnxModel(nn.Module):
  """The model as a function of the observations, images and hidden state of one world.

  Args:
    rnn: Recurrent layer of the model.
    plain: rsl-rl's copy of the model without a recurrent layer, which is put before its hidden layers.
  """

  def __init__(self, rnn: RNN, plain: Any) -> None:
    super().__init__()
    # Gradients of the hidden state cannot be copied.
    self.rnn: nn.GRU | nn.LSTM = copy.deepcopy(rnn.rnn)
    self.mlp, self.output = plain.mlp, plain.deterministic_output
    plain.mlp = plain.deterministic_output = nn.Identity()
    self.encoders = plain
    names = ("h", "c") if isinstance(self.rnn, nn.LSTM) else ("h",)
    self.input_names = [*plain.input_names, *(f"{name}_in" for name in names)]
    self.output_names = [*plain.output_names, *(f"{name}_out" for name in names)]
    # Separate tensors: the exporter takes one tensor for one input.
    memory = [torch.zeros(self.rnn.num_layers, 1, self.rnn.hidden_size) for _ in names]
    self._inputs = (*plain.get_dummy_inputs(), *memory)

  def forward(self, obs: torch.Tensor, *rest: torch.Tensor) -> tuple[torch.Tensor, ...]:
    count = len(self.encoders.cnns)
    memory: Any = rest[count:] if isinstance(self.rnn, nn.LSTM) else rest[count]
    latent, following = self.rnn(self.encoders(obs, *rest[:count]).unsqueeze(0), memory)
    states = following if isinstance(following, tuple) else (following,)
    return self.output(self.mlp(latent.squeeze(0))), *states

  def get_dummy_inputs(self) -> tuple[torch.Tensor, ...]:
    return self._inputs
