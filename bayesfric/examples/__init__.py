"""Simulated recordings that come with the package, their configurations and their truth."""
