"""Address of a page."""

import logging
import socket

from mjlab_core import MjlabError, UsageError


def check_address(host: str, port: int) -> None:
  """Check that this machine can listen on an address; otherwise the server would wait without end.

  Raises:
    UsageError: There is no such port.
    MjlabError: It cannot listen.
  """
  if not 0 < port < 65536:
    raise UsageError(f"port {port} does not exist; use 1 to 65535")
  try:
    # If the port is taken, the server itself uses the next one.
    with socket.create_server((host, 0)):
      pass
  except OSError as error:
    # Python repeats the address after the system's message.
    reason = (error.strerror or str(error)).partition(" (while ")[0]
    raise MjlabError(f"cannot listen on {host}: {reason}") from error


def ignore_failed_handshakes() -> None:
  """Keep the server from printing a traceback for connections that are not from a browser, such as scans of ports."""
  logging.getLogger("websockets.server").addFilter(_is_not_a_failed_handshake)


def _is_not_a_failed_handshake(record: logging.LogRecord) -> bool:
  return record.getMessage() != "opening handshake failed"
