"""Actuator models: MuJoCo's own, PD, DC motor and learned."""
