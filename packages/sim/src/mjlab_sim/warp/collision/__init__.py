"""Search for pairs of geoms, and contacts with height fields."""
