"""The one exception of this package."""


class SimulationError(ValueError):
  """A model, option or request that the chosen engine cannot serve; the message says what would work."""
