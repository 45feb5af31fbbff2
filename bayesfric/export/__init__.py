"""The numbers of a finished run in a simulator's terms. Called, it exports.

Files of a format, what they lose of the fitted joint, and how much torque that is.
"""
