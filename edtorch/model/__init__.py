"""The model of the next state (Fig. 1, steps 1 and 2): features, models, their fits, the noise."""
