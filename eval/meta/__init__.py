"""Whether the metrics see what they are meant to see: graded corruptions of a true performance, and what each metric says."""
