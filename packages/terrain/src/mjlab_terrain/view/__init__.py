"""Pictures and a browser page of a terrain. They need the extra `view`."""
