"""Descriptions of motion that hold nothing of the performer's size, for classifiers and for distances of distributions."""
