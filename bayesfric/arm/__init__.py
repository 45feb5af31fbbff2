"""Whole arms: every joint of one log, beside the torque that the bodies of a URDF ask for."""
