"""What every room stands on: errors, files opened and written, progress, templates."""
