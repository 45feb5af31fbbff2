"""What the recordings say of parameters: likelihoods of torque and of position, and noise."""
