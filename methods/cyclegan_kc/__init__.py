"""Cycle-consistent style transfer with kinematic constraints on a convolutional autoencoder (Wang et al. 2021)."""
