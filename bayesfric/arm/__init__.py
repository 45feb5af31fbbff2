"""Whole arms: every joint of one log, in addition to the rigid-body torque of a URDF."""
