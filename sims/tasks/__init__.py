"""Standard control tasks: balancing near a target, and swing-ups from hanging."""
