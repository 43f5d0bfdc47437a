"""Types of tile, by the solids that they are made of."""
