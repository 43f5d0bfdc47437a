"""Terms of all managers: protocol, parameters and the entities that they name."""
