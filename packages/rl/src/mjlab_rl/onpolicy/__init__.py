"""Extensions of rsl-rl's learners: recorded PPO, warm-up of the critic, distillation."""
