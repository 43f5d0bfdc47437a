"""Where a page is served."""

import socket

from mjlab_viewer.errors import ViewerError


def check_address(host: str, port: int) -> None:
  """Refuse an address that is not this machine's: the server would wait for it for ever.

  Raises:
    ViewerError: it cannot be listened on.
  """
  if not 0 < port < 65536:
    raise ViewerError(f"port {port} does not exist; there is 1 to 65535")
  try:
    # Whether this port is free is the server's own question; it takes the next one.
    with socket.create_server((host, 0)):
      pass
  except OSError as error:
    # Python repeats the address behind the system's own words.
    reason = (error.strerror or str(error)).partition(" (while ")[0]
    raise ViewerError(f"cannot listen on {host}: {reason}") from error
