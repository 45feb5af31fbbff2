"""What is known beforehand: priors, their defaults and those of the noise."""
