"""Trained evaluators: classifiers and feature extractors that metrics look through."""
