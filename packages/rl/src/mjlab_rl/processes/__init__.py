"""Several processes of one run, and signals that end it."""
