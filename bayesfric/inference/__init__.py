"""What we believe: priors, likelihood, coordinates, sampling, posterior."""
