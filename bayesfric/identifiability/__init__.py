"""What can be known from these recordings."""
