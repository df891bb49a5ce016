"""Style transfer by descent in the hidden space of a convolutional motion autoencoder (Holden, Saito & Komura 2016)."""
