"""One experiment: a motion, runs of it, the converged reference, errors and cost."""
