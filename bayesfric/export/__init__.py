"""Exports of a finished run: files of a format, the terms that it loses, and the torque error."""
