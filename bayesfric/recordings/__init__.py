"""Recordings: read, checked and filtered, in SI units on a uniform time base."""
