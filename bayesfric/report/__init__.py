"""What we tell: tables, figures, pages. Called, it writes a run directory."""
