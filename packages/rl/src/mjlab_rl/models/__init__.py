"""Networks of learners."""
