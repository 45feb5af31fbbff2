"""What the joint is: elements, chain, inverse and forward model."""
