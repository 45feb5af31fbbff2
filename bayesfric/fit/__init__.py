"""Recordings and a joint in, a concluded posterior out: one page a step."""
