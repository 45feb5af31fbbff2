"""What we tell: numbers, figures, the run directory."""
