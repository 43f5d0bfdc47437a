"""Image encoder with positions in the image as features."""

from typing import Any, cast

import torch
from rsl_rl.modules import CNN
from torch import nn

from mjlab_rl.models.networks import ImageModel


class SpatialSoftmax(nn.Module):
  """Expected place of each channel's activation, (B, C, H, W) to (B, 2 C): x of all channels in [-1, 1], then y.

  Levine et al. 2016, End-to-end training of deep visuomotor policies, arXiv:1504.00702.
  """

  def __init__(self, height: int, width: int, temperature: float = 1.0) -> None:
    super().__init__()
    y, x = torch.meshgrid(torch.linspace(-1, 1, height), torch.linspace(-1, 1, width), indexing="ij")
    self._x: torch.Tensor
    self._y: torch.Tensor
    self.register_buffer("_x", x.flatten(), persistent=False)
    self.register_buffer("_y", y.flatten(), persistent=False)
    self._temperature = temperature

  def forward(self, features: torch.Tensor) -> torch.Tensor:
    weight = torch.softmax(features.flatten(2) / self._temperature, dim=-1)
    return torch.cat([(weight * self._x).sum(-1), (weight * self._y).sum(-1)], dim=-1)


class SpatialSoftmaxCNNModel(ImageModel):
  """An `ImageModel` whose encoders end in a spatial softmax instead of all their features.

  `cnn_cfg` may have a `temperature`, and no flattening or global pooling. Select this model with
  `class_name="mjlab_rl.models.spatial_softmax:SpatialSoftmaxCNNModel"`.
  """

  @staticmethod
  def make_encoder(images: torch.Tensor, *, temperature: float = 1.0, **cfg: Any) -> nn.Module:
    _, channels, height, width = images.shape
    cnn = CNN(input_dim=(height, width), input_channels=channels, flatten=False, **cfg)
    # Without flattening both are known; rsl-rl's types allow for either.
    size, features = cast("tuple[int, int]", cnn.output_dim), cast("int", cnn.output_channels)
    encoder: Any = nn.Sequential(cnn, SpatialSoftmax(*size, temperature))
    # CNNModel reads both.
    encoder.output_channels, encoder.output_dim = None, 2 * features
    return encoder
