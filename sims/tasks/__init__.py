"""Standard control tasks: a cart-pole, a quadrotor, a pendulum near upright."""
