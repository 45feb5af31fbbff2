"""What ``summary.json`` holds: every number of a run, with what must be said of it."""
