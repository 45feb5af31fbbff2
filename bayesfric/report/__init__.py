"""Reports: terminal, tables, figures, pages. Called, it writes a run directory."""
