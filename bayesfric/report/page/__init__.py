"""The pages: one self-contained HTML file of a run, and one of several runs."""
