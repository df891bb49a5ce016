"""Building blocks shared by the learned methods. Importing any module here but ``presets`` imports torch."""
