"""The value of a policy under a model, and its gradient (Fig. 1, steps 3 to 6)."""
