"""Experiments: the runs of a motion, the converged reference, errors and costs."""
