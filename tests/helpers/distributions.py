"""Tests of distributions."""

import numpy as np
from scipy.stats import kstest


def uniform(values, low, high):
    """Within the bounds, and uniform as far as a Kolmogorov-Smirnov test can tell."""
    values = np.ravel(values)
    assert (values >= low).all()
    assert (values <= high).all()
    return kstest(values, "uniform", (low, high - low)).pvalue > 1e-3
