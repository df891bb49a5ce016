"""The papers' empirical claims, each with a test and what came of it on a run."""
