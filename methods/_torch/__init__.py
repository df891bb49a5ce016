"""Differentiable building blocks shared by the learned methods. Importing any module here imports torch."""
