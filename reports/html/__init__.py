"""The parts of the page of a run: each turns stored tables and clips into what a template shows."""
