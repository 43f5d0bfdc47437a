"""Page in a browser, served by viser and mjviser."""
