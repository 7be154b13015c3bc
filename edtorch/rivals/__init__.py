"""Other ways to find a policy, one file each, on the same simulators as the learner."""
