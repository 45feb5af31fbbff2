"""Methods, posteriors and runs side by side."""
