"""One tick of learning as a pure function (Fig. 1), and what a learner makes of its
observations."""
