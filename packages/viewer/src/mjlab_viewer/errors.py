"""What a viewer refuses."""


class ViewerError(ValueError):
  """A setting that a viewer cannot serve; the message says which and what is possible."""


class RenderingError(RuntimeError):
  """Pictures cannot be made on this machine; the message is one line and says what is missing."""
