"""What ``summary.json`` holds: every number of a run, with its messages."""
