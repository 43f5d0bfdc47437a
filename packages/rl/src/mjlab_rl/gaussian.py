"""Actions that are drawn without waiting for the device."""

import torch
from rsl_rl.modules import GaussianDistribution


class Gaussian(GaussianDistribution):
  """rsl-rl's GaussianDistribution, bit for bit, without `torch.normal`: that reads back whether a std is negative."""

  def sample(self) -> torch.Tensor:
    with torch.no_grad():
      return torch.randn_like(self.mean).mul_(self.std).add_(self.mean)
