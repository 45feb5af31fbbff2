"""What a fit says: point estimates."""
