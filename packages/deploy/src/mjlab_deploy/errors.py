"""The error of policy bundles and of their runner."""


class DeployError(ValueError):
  """Mistake in what a user gave: a bundle that cannot be read, a robot that it does not fit, an option."""
