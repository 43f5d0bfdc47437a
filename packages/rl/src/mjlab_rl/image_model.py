"""A network that sees, and may remember what it saw."""

import contextlib
import copy
import io
from typing import Any, Literal, cast

import torch
from rsl_rl.models import CNNModel
from rsl_rl.modules import CNN, RNN, HiddenState
from tensordict import TensorDict
from torch import nn

from mjlab_rl.config import ConfigError


class ImageModel(CNNModel):
  """rsl-rl's CNNModel with, if wanted, a recurrent layer between what is seen and the hidden layers.

  Images go through their encoders, which may be shared with another network, and beside the other observations into
  the recurrent layer. One that does not remember may be trained beside one that does.

  Args:
    obs: Observations by group, images (N, C, H, W).
    obs_groups: Groups of each network.
    obs_set: Which network this is.
    output_dim: Width of the output.
    cnn_cfg: Encoders, one description for all image groups or one for each.
    cnns: Encoders of another network, to share; they stay that one's, whose optimiser and checkpoint they are in.
    rnn_type: Recurrent layer; None: none.
    rnn_hidden_dim: Width of the recurrent layer.
    rnn_num_layers: Number of recurrent layers.
    **options: The others of CNNModel.
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
    self._remembered_dim = rnn_hidden_dim
    encoders: Any = cnns
    if cnns is None:
      if not cnn_cfg:
        raise ConfigError("cnn_cfg must say what the image encoders are made of")
      images = {group: obs[group] for group in obs_groups[obs_set] if obs[group].dim() == 4}
      try:
        encoders = {group: self.make_encoder(image, **cnn_cfg.get(group, cnn_cfg)) for group, image in images.items()}
      except TypeError as error:
        raise ConfigError(f"cnn_cfg: {error}") from error
    # The parent says that encoders it is given are shared.
    with contextlib.redirect_stdout(io.StringIO()):
      super().__init__(obs, obs_groups, obs_set, output_dim, cnns=encoders, **options)
    if cnns is not None:
      # As modules of both networks, an optimiser of both would step them twice.
      del self._modules["cnns"]
      self.__dict__["cnns"] = cnns
    seen_dim = self.obs_dim + self.cnn_latent_dim
    self.rnn = RNN(seen_dim, rnn_hidden_dim, rnn_num_layers, rnn_type) if rnn_type is not None else None

  @staticmethod
  def make_encoder(images: torch.Tensor, **cfg: Any) -> nn.Module:
    """An encoder of images such as these; what it is called with is CNNModel's `cnn_cfg`."""
    _, channels, height, width = images.shape
    return CNN(input_dim=(height, width), input_channels=channels, **cfg)

  def get_latent(
    self, obs: TensorDict, masks: torch.Tensor | None = None, hidden_state: HiddenState = None
  ) -> torch.Tensor:
    """What the hidden layers take of (N, ...) observations, (N, D), or of (T, N, ...) trajectories, (T, N, D)."""
    # Convolutions take one batch of images.
    seen = super().get_latent(cast("TensorDict", obs.flatten(0, obs.dim() - 1))).unflatten(0, obs.shape)
    return seen if self.rnn is None else self.rnn(seen, masks, hidden_state).squeeze(0)

  def reset(self, dones: torch.Tensor | None = None, hidden_state: HiddenState = None) -> None:
    """Forget what was remembered of the worlds that are done, (N,); None: of all, or remember `hidden_state`."""
    if self.rnn is not None:
      self.rnn.reset(dones, hidden_state)

  def get_hidden_state(self) -> HiddenState:
    """What is remembered: (layers, N, width), of an LSTM two of them; None: nothing."""
    return None if self.rnn is None else cast("HiddenState", self.rnn.hidden_state)

  def detach_hidden_state(self, dones: torch.Tensor | None = None) -> None:
    """Learn nothing through what was remembered so far, of all worlds or of those that are done, (N,)."""
    if self.rnn is not None:
      self.rnn.detach_hidden_state(dones)

  def as_jit(self) -> nn.Module:
    """A copy for torch.jit: `forward(obs_1d, images)` of one world, which remembers until `reset()`."""
    return super().as_jit() if self.rnn is None else _ScriptedModel(self)

  def as_onnx(self, verbose: bool = False) -> nn.Module:
    """A copy for ONNX: takes the observations, each image group, and what it remembers, which it gives back."""
    return super().as_onnx(verbose) if self.rnn is None else _OnnxModel(self)

  def _get_latent_dim(self) -> int:
    return self._remembered_dim if self.is_recurrent else super()._get_latent_dim()


class _GruStep(nn.Module):
  def __init__(self, rnn: nn.GRU) -> None:
    super().__init__()
    self.rnn = rnn

  def forward(self, seen: torch.Tensor, memory: list[torch.Tensor]) -> tuple[torch.Tensor, list[torch.Tensor]]:
    out, hidden = self.rnn(seen.unsqueeze(0), memory[0])
    return out.squeeze(0), [hidden]


class _LstmStep(nn.Module):
  def __init__(self, rnn: nn.LSTM) -> None:
    super().__init__()
    self.rnn = rnn

  def forward(self, seen: torch.Tensor, memory: list[torch.Tensor]) -> tuple[torch.Tensor, list[torch.Tensor]]:
    out, (hidden, cell) = self.rnn(seen.unsqueeze(0), (memory[0], memory[1]))
    return out.squeeze(0), [hidden, cell]


class _Functional(nn.Module):
  """The model as a function of what is seen and remembered."""

  def __init__(self, model: ImageModel) -> None:
    super().__init__()
    assert model.rnn is not None
    # Without what is remembered, whose gradients cannot be copied.
    rnn: nn.GRU | nn.LSTM = copy.deepcopy(model.rnn.rnn)
    self.obs_normalizer = copy.deepcopy(model.obs_normalizer)
    self.cnns = nn.ModuleList([copy.deepcopy(model.cnns[group]) for group in model.obs_groups_2d])
    self.step = _LstmStep(rnn) if isinstance(rnn, nn.LSTM) else _GruStep(rnn)
    self.mlp = copy.deepcopy(model.mlp)
    distribution = model.distribution
    self.output = nn.Identity() if distribution is None else distribution.as_deterministic_output_module()

  def forward(
    self, obs: torch.Tensor, images: list[torch.Tensor], memory: list[torch.Tensor]
  ) -> tuple[torch.Tensor, list[torch.Tensor]]:
    seen = [self.obs_normalizer(obs)]
    for i, cnn in enumerate(self.cnns):
      seen.append(cnn(images[i]))
    latent, memory = self.step(torch.cat(seen, dim=-1), memory)
    return self.output(self.mlp(latent)), memory


def _blank(model: ImageModel) -> list[torch.Tensor]:
  """What one world remembers at its beginning."""
  assert model.rnn is not None
  rnn: nn.GRU | nn.LSTM = model.rnn.rnn
  return [torch.zeros(rnn.num_layers, 1, rnn.hidden_size) for _ in range(2 if isinstance(rnn, nn.LSTM) else 1)]


class _ScriptedModel(nn.Module):
  def __init__(self, model: ImageModel) -> None:
    super().__init__()
    self.function = _Functional(model)
    self.memory: torch.Tensor
    self.register_buffer("memory", torch.stack(_blank(model)))

  def forward(self, obs_1d: torch.Tensor, obs_2d: list[torch.Tensor]) -> torch.Tensor:
    actions, memory = self.function(obs_1d, obs_2d, list(self.memory.unbind(0)))
    self.memory.copy_(torch.stack(memory))
    return actions

  @torch.jit.export
  def reset(self) -> None:
    self.memory.zero_()


class _OnnxModel(nn.Module):
  def __init__(self, model: ImageModel) -> None:
    super().__init__()
    self.function = _Functional(model)
    names = ("h", "c")[: len(_blank(model))]
    self.input_names = ["obs", *model.obs_groups_2d, *(f"{name}_in" for name in names)]
    self.output_names = ["actions", *(f"{name}_out" for name in names)]
    sizes = zip(model.obs_channels_2d, model.obs_dims_2d, strict=True)
    images = [torch.zeros(1, channels, *size) for channels, size in sizes]
    self._inputs = (torch.zeros(1, model.obs_dim), *images, *_blank(model))
    self._num_images = len(images)

  def forward(self, obs: torch.Tensor, *rest: torch.Tensor) -> tuple[torch.Tensor, ...]:
    actions, memory = self.function(obs, list(rest[: self._num_images]), list(rest[self._num_images :]))
    return actions, *memory

  def get_dummy_inputs(self) -> tuple[torch.Tensor, ...]:
    return self._inputs
