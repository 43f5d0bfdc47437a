"""The spatial softmax and the model that ends in it."""

from typing import Any

import numpy as np
import pytest
import torch
from mjlab_rl.models.spatial_softmax import SpatialSoftmax, SpatialSoftmaxCNNModel
from tensordict import TensorDict

CNN = {"output_channels": (16, 32), "kernel_size": (5, 3), "stride": (2, 2), "padding": "zeros"}


def observations(channels: int = 1) -> TensorDict:
  generator = torch.Generator().manual_seed(0)
  image = torch.rand(3, channels, 32, 32, generator=generator)
  return TensorDict({"actor": torch.rand(3, 5, generator=generator), "camera": image}, batch_size=[3])


def model(obs: TensorDict, **options: Any) -> SpatialSoftmaxCNNModel:
  groups = {"actor": ["actor", "camera"]}
  return SpatialSoftmaxCNNModel(obs, groups, "actor", 2, hidden_dims=(8,), **options)


def test_a_sharp_peak_gives_its_place_and_flat_features_the_middle() -> None:
  features = torch.zeros(1, 3, 4, 6)
  features[0, 0, 1, 4] = 60.0
  features[0, 1, 3, 0] = 60.0
  places = SpatialSoftmax(4, 6)(features)[0].tolist()
  # x of the three channels, then y; from one edge of the image, -1, to the other, 1.
  assert places == pytest.approx([2 * 4 / 5 - 1, -1.0, 0.0, 2 * 1 / 3 - 1, 1.0, 0.0], abs=1e-6)


def test_the_result_is_the_expected_place_at_a_temperature() -> None:
  features = torch.randn(2, 3, 5, 7, generator=torch.Generator().manual_seed(1))
  got = SpatialSoftmax(5, 7, temperature=0.5)(features).numpy()
  weight = np.exp(features.numpy() / 0.5)
  weight /= weight.sum((2, 3), keepdims=True)
  x, y = np.linspace(-1, 1, 7), np.linspace(-1, 1, 5)
  expected = np.concatenate([(weight.sum(2) * x).sum(-1), (weight.sum(3) * y).sum(-1)], axis=1)
  np.testing.assert_allclose(got, expected, atol=1e-6)


@pytest.mark.parametrize(("channels", "weights"), [(1, 5056), (2, 5456), (3, 5856)])
def test_an_encoder_makes_64_numbers_of_an_image(
  channels: int, weights: int, capsys: pytest.CaptureFixture[str]
) -> None:
  obs = observations(channels)
  network = model(obs, cnn_cfg=CNN)
  assert network.get_latent(obs).shape == (3, 5 + 64)
  assert sum(p.numel() for p in network.cnns.parameters()) == weights
  assert network(obs).shape == (3, 2)
  # CNNModel prints that given encoders are shared; these are not.
  assert "Sharing" not in capsys.readouterr().out


def test_encoders_can_be_shared_and_configured_by_group() -> None:
  obs = observations()
  first = model(obs, cnn_cfg={"camera": {**CNN, "temperature": 2.0}})
  second = model(obs, cnns=first.cnns)
  assert second.cnns["camera"] is first.cnns["camera"]


def test_an_exported_model_gives_the_same_output() -> None:
  obs = observations()
  network = model(obs, cnn_cfg=CNN)
  exported = network.as_jit()(obs["actor"], [obs["camera"]])
  torch.testing.assert_close(exported, network(obs))


def test_an_encoder_without_settings_is_refused() -> None:
  with pytest.raises(ValueError, match="image groups need cnn_cfg"):
    model(observations())
