"""Bayesian optimisation around a trajectory, which ACNMP and its twins share."""
