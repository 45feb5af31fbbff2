"""What a measured motor torque says about a joint, as posteriors."""

__version__ = "0.1.0"
