"""What would explain the residual: terms that the model lacks, judged by motion not fitted."""
