"""The torque likelihood at a cost that does not grow with the data: moments of residuals."""
