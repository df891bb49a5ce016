"""Adult2child: a CycleGAN over motion words of joint rotations (Dong et al., MIG 2020)."""
