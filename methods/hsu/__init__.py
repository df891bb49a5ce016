"""Iterative motion warping and linear time-invariant models (Hsu, Pulli & Popović 2005; Dong et al. 2018)."""
