"""Networks of off-policy learners on rsl-rl's model classes: layers, bounded policy, distributional critics."""

import copy
import math
from functools import partial
from typing import Any, Literal, cast

import torch
from rsl_rl.models import MLPModel
from rsl_rl.modules import EmpiricalNormalization
from rsl_rl.modules.distribution import Distribution
from rsl_rl.utils import resolve_nn_activation
from torch import distributed, nn
from torch.nn import functional

from mjlab_rl.models.networks import merge_moments

Layers = Literal["layer_norm", "unit"]


class Normalizer(EmpiricalNormalization):
  """rsl-rl's EmpiricalNormalization with an update that does not wait for the device.

  The update writes in place, because a recorded graph reads the statistics at a fixed address.
  """

  _mean: torch.Tensor

  def update(self, x: torch.Tensor) -> None:
    """Learn from a batch, (batch, width), and from the batches of the other processes."""
    count, mean = x.shape[0], x.mean(0, keepdim=True)
    var = x.var(0, unbiased=False, keepdim=True)
    if distributed.is_initialized():
      moments = torch.stack((mean, var + mean.square()))
      distributed.all_reduce(moments)
      mean, square = moments / distributed.get_world_size()
      var, count = (square - mean.square()).clamp(min=0.0), count * distributed.get_world_size()
    merge_moments(self, count, mean - self._mean, var)


class TanhGaussian(Distribution):
  """Gaussian squashed by tanh to [-bound, bound], with a standard deviation that depends on the state.

  Densities are densities of the action after tanh and bound.

  Args:
    output_dim: Number of actions.
    log_std_range: Range of the logarithm of the standard deviation before tanh.
  """

  def __init__(self, output_dim: int, log_std_range: tuple[float, float] = (-5.0, 0.0)) -> None:
    super().__init__(output_dim)
    self.bound: torch.Tensor
    self.register_buffer("bound", torch.ones(1, output_dim))
    self._low, self._high = log_std_range
    self._std = torch.zeros(1, output_dim)

  def split(self, output: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return mean and standard deviation before tanh of a network's output (..., 2, num_actions)."""
    mean, raw = output.float().unbind(-2)
    return mean, torch.exp(self._low + 0.5 * (self._high - self._low) * (1.0 + torch.tanh(raw)))

  def update(self, mlp_output: torch.Tensor) -> None:
    _, std = self.split(mlp_output.detach())
    self._std = std * self.bound

  def act(self, output: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
    """Return the actions for standard normal noise, (..., num_actions)."""
    mean, std = self.split(output)
    return torch.tanh(mean + std * noise) * self.bound

  def sample_with_log_prob(self, output: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return differentiable random actions and the logarithm of their density, (batch, num_actions), (batch,)."""
    mean, std = self.split(output)
    noise = torch.randn_like(mean)
    x = mean + std * noise
    log_normal = -0.5 * noise.square() - std.log() - 0.5 * math.log(2.0 * math.pi)
    # log(1 - tanh(x)^2) without cancellation.
    log_slope = 2.0 * (math.log(2.0) - x - functional.softplus(-2.0 * x)) + self.bound.log()
    return torch.tanh(x) * self.bound, (log_normal - log_slope).sum(-1)

  def deterministic_output(self, mlp_output: torch.Tensor) -> torch.Tensor:
    return torch.tanh(mlp_output[..., 0, :]) * self.bound

  forward = deterministic_output

  def as_deterministic_output_module(self) -> nn.Module:
    """Return a copy, which an exported network calls."""
    return copy.deepcopy(self)

  @property
  def input_dim(self) -> list[int]:
    return [2, self.output_dim]

  @property
  def std(self) -> torch.Tensor:
    """Standard deviation of the last actions before tanh, in units of the action."""
    return self._std


class _Model(MLPModel):
  """rsl-rl's model with a `Normalizer`."""

  def __init__(self, *args: Any, layers: Layers, hidden_dims: Any, activation: str, **options: Any) -> None:
    # The parent's hidden layers are replaced; they are built as small as possible.
    super().__init__(*args, hidden_dims=(1,), activation=activation, **options)
    self._stack = partial(stack, layers, hidden_dims=hidden_dims, activation=activation)
    self.is_unit = layers == "unit"
    """True if batches are normalised, and weights after each step."""
    if self.obs_normalization:
      self.obs_normalizer = Normalizer(self.obs_dim)

  def learn_statistics(self, obs: torch.Tensor) -> None:
    """Let the normaliser learn from observations of the groups side by side, (batch, width)."""
    if isinstance(self.obs_normalizer, Normalizer):
      self.obs_normalizer.update(obs)


class Actor(_Model):
  """Policy with a bounded Gaussian; `output` takes the observations of its groups side by side."""

  def __init__(self, *args: Any, **options: Any) -> None:
    super().__init__(*args, **options)
    rows, columns = self.squash.input_dim
    inner = self._stack(self.obs_dim, output_dim=rows * columns, zero_output=not self.is_unit)
    self.mlp: nn.Module = nn.Sequential(inner, nn.Unflatten(-1, (rows, columns)))

  @property
  def squash(self) -> TanhGaussian:
    """The distribution."""
    return cast("TanhGaussian", self.distribution)

  def output(self, obs: torch.Tensor) -> torch.Tensor:
    """Return the input of the distribution, (batch, 2, num_actions)."""
    return self.mlp(self.obs_normalizer(obs))


class Critic(_Model):
  """Two estimates of the distribution of returns over fixed values (C51, Bellemare et al. 2017, arXiv:1707.06887).

  Args:
    num_actions: Number of actions, an input.
    num_atoms: Number of values.
    value_limit: The values reach from -value_limit to value_limit.
    **options: Other options of a model, such as `layers` and `hidden_dims`.
  """

  def __init__(self, *args: Any, num_actions: int, num_atoms: int, value_limit: float, **options: Any) -> None:
    super().__init__(*args, num_atoms, **options)
    width = self.obs_dim + num_actions
    nets = [self._stack(width, output_dim=num_atoms, zero_output=False) for _ in range(2)]
    self.mlp: nn.Module = nn.ModuleList(nets)
    self.support: torch.Tensor
    self.register_buffer("support", torch.linspace(-value_limit, value_limit, num_atoms))

  def logits(self, obs: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
    """Return the logits of both estimates, (2, batch, num_atoms) float32."""
    seen = torch.cat((self.obs_normalizer(obs), action), -1)
    return torch.stack([net(seen) for net in self.mlp.children()]).float()

  def values(self, logits: torch.Tensor) -> torch.Tensor:
    """Return the expected returns of logits, (2, batch)."""
    return logits.softmax(-1) @ self.support


def stack(
  layers: Layers, width: int, hidden_dims: Any, output_dim: int, activation: str, *, zero_output: bool
) -> nn.Sequential:
  """Return a network of hidden layers and a linear output.

  Args:
    layers: "layer_norm": LayerNorm before each activation (FastSAC, arXiv:2512.01996); "unit": residual blocks of
      batch-normalised layers with weights of unit norm (FlashSAC, arXiv:2604.04539), one block for each width.
    width: Width of the input.
    hidden_dims: Widths of the hidden layers.
    output_dim: Width of the output.
    activation: Activation function by rsl-rl's name.
    zero_output: Start with output 0.
  """
  if layers == "unit":
    hidden = hidden_dims[0]
    parts: list[nn.Module] = [nn.BatchNorm1d(width, momentum=0.01), _unit_linear(width, hidden)]
    parts += [UnitBlock(hidden, activation) for _ in hidden_dims]
    parts += [nn.RMSNorm(hidden, eps=1e-6), _unit_linear(hidden, output_dim, bias=True)]
    net = nn.Sequential(*parts)
    renormalize(net)
    return net
  parts: list[nn.Module] = []
  for inputs, outputs in zip((width, *hidden_dims), hidden_dims, strict=False):
    parts += [nn.Linear(inputs, outputs), nn.LayerNorm(outputs), resolve_nn_activation(activation)]
  last = nn.Linear(hidden_dims[-1], output_dim)
  if zero_output:
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
  return nn.Sequential(*parts, last)


class UnitBlock(nn.Module):
  """Residual block of FlashSAC: two batch-normalised layers, the first one four times as wide."""

  def __init__(self, width: int, activation: str) -> None:
    super().__init__()
    self.inner = nn.Sequential(
      _unit_linear(width, 4 * width),
      nn.BatchNorm1d(4 * width, momentum=0.01),
      resolve_nn_activation(activation),
      _unit_linear(4 * width, width),
      nn.BatchNorm1d(width, momentum=0.01),
      resolve_nn_activation(activation),
    )

  def forward(self, x: torch.Tensor) -> torch.Tensor:
    return x + self.inner(x)


def _unit_linear(inputs: int, outputs: int, *, bias: bool = False) -> nn.Linear:
  linear = nn.Linear(inputs, outputs, bias=bias)
  nn.init.orthogonal_(linear.weight)
  if bias:
    nn.init.zeros_(linear.bias)
  return linear


@torch.no_grad()
def renormalize(network: nn.Module) -> None:
  """Give the weights of "unit" layers their norm again: 1 for each output, the root of the width for norms."""
  for module in network.modules():
    if isinstance(module, nn.Linear):
      module.weight.copy_(functional.normalize(module.weight, dim=-1))
    elif isinstance(module, (nn.BatchNorm1d, nn.RMSNorm)):
      parts: list[torch.Tensor] = [part for part in (module.weight, getattr(module, "bias", None)) if part is not None]
      total = torch.cat(parts).square().sum()
      factor = math.sqrt(module.weight.numel()) * torch.rsqrt(total + 1e-8)
      for part in parts:
        part.mul_(factor)
