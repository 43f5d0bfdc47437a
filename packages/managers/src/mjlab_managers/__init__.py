"""Action, command, curriculum, event, metrics, observation, recorder, reward and termination managers."""
