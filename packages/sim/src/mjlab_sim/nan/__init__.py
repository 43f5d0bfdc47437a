"""Records of worlds that diverged."""
